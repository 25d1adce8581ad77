/* Inside the core: sine and cosine at once. */
#ifndef STOPSET_MATHS_H
#define STOPSET_MATHS_H
void stopset_sincos(double x, double *s, double *c);
void stopset_sincos_of_four(const double *x, double *s, double *c); /* (4,) each; the same bits */
#endif
