/* Inside the core: the compensation of up to ROWS samples, and what laws look at there. */
#ifndef STOPSET_INPUTS_H
#define STOPSET_INPUTS_H
#include "law.h"

/* What laws look at, of one joint, before the rows: the order of `SIGNALS` in stopset.artifact.taped. */
enum {
    S_Q, S_DQ, S_DDQ, S_DIRECTION, S_LOAD, S_TAU, S_DTAU, S_LINK, S_TEMP, S_WARM, S_T, S_STIFF, S_INERTIA, S_CORIOLIS, S_DQ_OTHER,
    S_TILT, S_TIP = S_TILT + 2, S_MEMORY = S_TIP + 10
};

/* The rigid body's part in what laws look at, of `rows` samples. */
typedef struct {
    double load[STOPSET_JOINTS][ROWS], link[STOPSET_JOINTS][ROWS], stiff[STOPSET_JOINTS][ROWS], inertia[STOPSET_JOINTS][ROWS];
    double tilt[STOPSET_JOINTS][2][ROWS], tip[STOPSET_JOINTS][10][ROWS];
} StopsetRigid;

/* q, dq (rows, n); `rest`: only what changes where the arm does not move. */
void stopset_rigid_signals(const StopsetInputs *map, int rows, const double *q, const double *dq, int rest, StopsetRigid *out);

/* So many samples, moving or (0) taken to be at rest; `direction` of friction 0: that of dq, else the given one. */
typedef struct {
    int rows, moves;
    double direction;
} StopsetLook;

/* Signals of one law at its joint. */
void stopset_law_signals(const StopsetInputs *map, const StopsetLaw *law, const StopsetLook *look, const StopsetSamples *s,
                         const StopsetRigid *rigid, double (*out)[ROWS]);
#endif
