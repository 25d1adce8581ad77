/* Inside the core: sine and cosine at once. */
#ifndef STOPSET_MATHS_H
#define STOPSET_MATHS_H
void stopset_sincos(double x, double *s, double *c);
#endif
