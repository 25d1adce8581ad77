/* Inside the simulator, which shares no line with what bounds stops: the tests hold bounds against it. */
#ifndef STOPSET_SIMULATION_H
#define STOPSET_SIMULATION_H
#include "../stopset.h"

enum { SIM_JOINTS = 16, SIM_STATES = 2 * SIM_JOINTS };

/* One step's friction problem, row by row; see inclusion.c. */
typedef struct {
    int n;
    double A[SIM_STATES * SIM_STATES], L[SIM_STATES * SIM_STATES], b[SIM_STATES], plus[SIM_STATES], minus[SIM_STATES], w[SIM_STATES];
    int mode[SIM_STATES];
} SimFriction;

void sim_mass_and_bias(const StopsetArm *arm, const double *q, const double *dq, double *M, double *bias);
int sim_solve(SimFriction *f);
double sim_first_crossing(SimFriction *f, const double *v, int *joint);
int sim_crosses(const SimFriction *f, const double *v);

enum { SIM_SPLITS = 4 };             /* events per joint in one step before the rest of it is taken unsplit */
#define SIM_SMALLEST 1e-6            /* of a step: what is closer than this happens now */
#endif
