/* Inside the proofs of whole stops: room for one tube, and what is told of it. */
#ifndef STOPSET_BOUND_H
#define STOPSET_BOUND_H
#include "stops.h"

/* Angles, `travel` beyond the box, and speeds that a stop is taken not to leave, until shown; `known`: found by a tube and not guessed.
 * `friction`: what the effects give there, once `asked`. The same as stopset.reach.stops.tubes.Region. */
typedef struct {
    double travel[SN], speed[SN], friction[6 * SN];
    int known, asked;
} Region;

/* A stop from the box q +- q_radius, dq +- dq_radius, (n,) each, of some `lasts` seconds; `tube` has `made` steps. */
typedef struct {
    const StopsetStops *stops;
    StopsetStates from;
    double lasts;
    double *lines, *cut; /* of the slices: work of stopset_slices, boxes and sets */
    StopsetTube tube;
    int64_t made;
    int fine; /* steps of the kinetic energy's tube, for one payload and for those that are alike */
} StopAsk;

/* Take the tube's memory from `work`; empty the bound. */
void stops_begin(StopAsk *ask, double *work, const StopsetBound *out);
/* A first guess for the box of `ask`. */
void stops_guess(const StopAsk *ask, Region *region);
/* One tube with the friction of a region that it does not leave, given or found here, and its largest speeds; whether it comes to rest. */
int stops_march(StopAsk *ask, const double *delay_lo, const double *delay_hi, int energetic, Region *region, double fastest[SN]);
/* `plant` with friction (6, n) in place of its own. */
StopsetPlant stops_with_friction(const StopsetPlant *plant, const double *friction);
/* The first knot from which joint i's speed bounds are zero [s]. */
double stops_rests_after(const StopAsk *ask, int i);
/* The bound widened by the tube, whose displacements count from q +- q_radius: all but the time. */
void stops_widen(const StopAsk *ask, const double *q, const double *q_radius, const double fastest[SN], const StopsetBound *out);
/* The plant with what the effects give at angles in [q_lo, q_hi], no joint faster than `speed`; 0 where they have no bound. */
int stops_near(const StopsetStops *stops, const double *q_lo, const double *q_hi, const double *speed, double friction[6 * SN], StopsetPlant *out);
/* Whether brakes and dry friction surely hold the arm anywhere in q +- radius. */
int stops_held(const StopsetStops *stops, const double *q, const double *radius);
#endif
