/* Predictions of a nonlinear model from past samples: which there are, which are looked at when, and a new sample against these.
 *
 * Monitor and FMU both come through here. Of decoupled joints all predictions go on step by step as two corners. Of all others only the
 * states they start from are kept: bounds along a nominal motion cost as the square of its age, so they are taken at some ages, at the
 * old ones in turn. The bounds are those of `predicted_tube` of stopset.reach.nonlinear, wider by what the bus rounds and what is not
 * known of the input.
 *
 * Source: Liu & Althoff (2018), Def. 2 and Sec. IV-C; Smith (1995), ch. 3.
 */
#include <string.h>

#include "stops/laws.h"
#include "stopset.h"

enum { J = STOPSET_JOINTS, X = 2 * STOPSET_JOINTS };
enum { STEPS = STOPSET_ALONG_STEPS, SAMPLES = STOPSET_ALONG_SAMPLES, TURN = STOPSET_ALONG_TURN, OUTSIDE = STOPSET_ALONG_OUTSIDE };
static const double MARGIN = 0.5, RUNAWAY = 1e6; /* [rad/s] a corner is faster than any reading; where one that runs away is held */
static const double ROUND = 0x1p-42, TINY = 1e-300, inf = 1.0 / 0.0; /* of a bound, relative; of a width */

static int64_t place(const StopsetAlong *a, int64_t step) { return (int64_t)((uint64_t)step % (uint64_t)(a->oldest + 1)); }
static int64_t passed(const StopsetAlong *a) { return a->count[STEPS] < a->oldest ? a->count[STEPS] : a->oldest; }
static int starts(const StopsetAlong *a, int64_t age) { return a->starts[place(a, a->count[STEPS] - age)]; }
static int due(const StopsetAlong *a, int64_t age) { return starts(a, age) && (a->corners || !a->sliding || stopset_looked_at(age, a->oldest)); }
static double *corner(const StopsetAlong *a, int side, int64_t row) { return a->x + (side * (a->oldest + 1) + row) * 2 * a->dynamics->n; }
static int64_t parts(const StopsetAlong *a) { return stopset_parts(a->dynamics, a->dt, a->fastest + MARGIN); }

int64_t stopset_along_room(const StopsetDynamics *dynamics, int64_t oldest) {
    return stopset_ahead_room(dynamics, oldest) + (oldest + 1) * 3 * dynamics->n;
}

/* 1, 2, 3, 4, 6, 8, 12, ... and the oldest: near ones closely, far ones seldom. */
int stopset_looked_at(int64_t age, int64_t oldest) {
    int64_t odd = age;
    while (odd > 1 && odd % 2 == 0) odd /= 2;
    return age == oldest || (age > 0 && age < oldest && (odd == 1 || odd == 3));
}

void stopset_along_forget(const StopsetAlong *a) {
    memset(a->starts, 0, (size_t)(a->oldest + 1));
    memset(a->count, 0, STOPSET_ALONG_COUNTS * sizeof *a->count);
}

/* One step under the mean of the inputs since the last one. */
static void carry(const StopsetAlong *a, int outside) {
    const int n = a->dynamics->n;
    const int64_t row = place(a, a->count[STEPS]), cut = a->corners ? parts(a) : 0;
    double torque[2][J];
    for (int i = 0; i < n; i++) {
        const double u = a->sum[i] / (double)a->count[SAMPLES], du = a->sum[n + i];
        if (!a->corners) {
            a->u[2 * n * row + i] = u;
            a->u[2 * n * row + n + i] = du;
        }
        torque[0][i] = u - du + a->sets->U_lo[i];
        torque[1][i] = u + du + a->sets->U_hi[i];
    }
    for (int64_t age = 0; a->corners && age < a->oldest && age <= a->count[STEPS]; age++)
        for (int side = 0; side < 2 && starts(a, age); side++)
            stopset_corners(a->dynamics, 1, torque[side], a->dt, cut, RUNAWAY, corner(a, side, place(a, a->count[STEPS] - age)));
    a->outside[row] = (uint8_t)(outside || a->count[OUTSIDE]);
    a->count[STEPS]++;
}

static void by_corners(const StopsetAlong *a, int64_t age, double *lo, double *hi) {
    const int n2 = 2 * a->dynamics->n;
    const int64_t row = place(a, a->count[STEPS] - age);
    /* another number of parts than in identification may differ by what one step's integration does */
    const double h = stopset_corner_step, rough = parts(a) > 1 ? h * h * h * h * h / 120.0 : 0.0;
    for (int i = 0; i < n2; i++) {
        const double low = corner(a, 0, row)[i], high = corner(a, 1, row)[i], slack = (ROUND + rough) * most(size_of(low), size_of(high));
        const int none = a->sets->position_only && i >= n2 / 2;
        lo[i] = none ? -inf : low + (a->sets->V_lo[i] - a->rounding[i]) - slack;
        hi[i] = none ? inf : high + (a->sets->V_hi[i] + a->rounding[i]) + slack;
    }
}

static void by_path(const StopsetAlong *a, int64_t age, double *lo, double *hi) {
    const StopsetSets *given = a->sets;
    const int n = a->dynamics->n, n2 = 2 * n;
    double *path = a->work + stopset_ahead_room(a->dynamics, a->oldest), *u = path + (a->oldest + 1) * n2, du[J] = {0}, set[6][X];
    for (int64_t k = 0; k < age; k++) {
        const double *then = a->u + 2 * n * place(a, a->count[STEPS] - age + k);
        memcpy(u + k * n, then, (size_t)n * sizeof *u);
        for (int i = 0; i < n; i++) du[i] = most(du[i], then[n + i]);
    }
    /* sets are added with their ends rounded outward */
    for (int i = 0; i < n2; i++) {
        const double r = a->rounding[i];
        const Ends X0 = ends_out(given->X0_lo[i] - r, given->X0_hi[i] + r, 1), V = ends_out(given->V_lo[i] - r, given->V_hi[i] + r, 1);
        const Ends U = i < n ? ends_out(given->U_lo[i] - du[i], given->U_hi[i] + du[i], 1) : X0;
        const double ends[6] = {X0.lo, X0.hi, U.lo, U.hi, V.lo, V.hi};
        for (int k = 0; k < 6; k++) set[k][i] = ends[k];
    }
    const StopsetSets sets = {set[0], set[1], set[2], set[3], set[4], set[5], given->position_only};
    const StopsetStarts start = {1, age, a->x + n2 * place(a, a->count[STEPS] - age), u, a->dt};
    const StopsetNominal nominal = {age, path, u, a->dt};
    stopset_nominal(a->dynamics, &start, a->work, path);
    stopset_ahead(a->dynamics, &sets, &nominal, a->work, lo, hi);
}

void stopset_along_bounds(const StopsetAlong *a, int64_t age, double *lo, double *hi) {
    if (a->corners)
        by_corners(a, age, lo, hi);
    else
        by_path(a, age, lo, hi);
}

/* x against one prediction. */
static void hold(const StopsetAlong *a, const double *x, int64_t age, int foreign, const StopsetHeld *out) {
    const int n2 = 2 * a->dynamics->n;
    double lo[X], hi[X];
    stopset_along_bounds(a, age, lo, hi);
    for (int i = 0; i < n2; i++) {
        const double width = most(hi[i] - lo[i], TINY), beyond[2] = {(x[i] - hi[i]) / width, (lo[i] - x[i]) / width};
        /* written so that what is not a number is outside */
        const int bad[2] = {!(x[i] <= hi[i]), !(x[i] >= lo[i])};
        out->lo[i] = most(out->lo[i], lo[i]);
        out->hi[i] = least(out->hi[i], hi[i]);
        if (width < inf) out->room[i] = least(out->room[i], -2.0 * most(beyond[0], beyond[1]));
        for (int side = 0; side < 2; side++) {
            const int at = side * n2 + i;
            if (!bad[side] || (out->age[at] > 0 && !(beyond[side] > out->worst[at]))) continue;
            out->worst[at] = beyond[side];
            out->ends[2 * at] = lo[i];
            out->ends[2 * at + 1] = hi[i];
            out->age[at] = age;
            out->foreign[at] = (uint8_t)foreign;
        }
    }
}

/* x against all that are due: every corner; along paths the near ages of those looked at, and of the old ones the next in turn. */
static int64_t compare(const StopsetAlong *a, const double *x, const StopsetHeld *out) {
    const int n2 = 2 * a->dynamics->n;
    const int64_t last = passed(a);
    int64_t live = 0, far = 0, seen = 0;
    int foreign = 0;
    for (int i = 0; i < 2 * n2; i++) out->age[i] = 0;
    for (int i = 0; i < n2; i++) {
        out->room[i] = 1.0;
        out->lo[i] = -inf;
        out->hi[i] = inf;
    }
    for (int64_t age = STOPSET_NEAR + 1; age <= last; age++)
        far += due(a, age);
    a->count[TURN]++;
    for (int64_t age = 1; age <= last; age++) {
        foreign |= a->outside[place(a, a->count[STEPS] - age)];
        if (!due(a, age)) continue;
        if (!a->corners && age > STOPSET_NEAR && seen++ != a->count[TURN] % far) continue;
        hold(a, x, age, foreign, out);
        *out->oldest = age;
        live++;
    }
    return live;
}

/* A prediction from x: what is refuted itself predicts nothing. */
static void launch(const StopsetAlong *a, const double *x, const StopsetHeld *held) {
    const int n2 = 2 * a->dynamics->n;
    const int64_t row = place(a, a->count[STEPS]);
    int good = a->sliding || a->count[STEPS] == 0;
    for (int i = 0; i < 2 * n2; i++) good = good && held->age[i] == 0;
    a->starts[row] = (uint8_t)good;
    for (int i = 0; i < n2 && good; i++) {
        if (a->corners) {
            corner(a, 0, row)[i] = x[i] + (a->sets->X0_lo[i] - a->rounding[i]);
            corner(a, 1, row)[i] = x[i] + (a->sets->X0_hi[i] + a->rounding[i]);
        } else
            a->x[n2 * row + i] = x[i];
    }
}

int64_t stopset_along_sample(const StopsetAlong *a, int64_t every, const double *x, const double *u, const double *du, int outside,
                             const StopsetHeld *held) {
    const int n = a->dynamics->n;
    int64_t live = -1;
    if (!a->count[SAMPLES] || a->count[SAMPLES] >= every) {
        if (a->count[SAMPLES]) carry(a, outside);
        live = compare(a, x, held);
        launch(a, x, held);
        a->count[SAMPLES] = a->count[OUTSIDE] = 0;
    }
    for (int i = 0; i < n; i++) {
        a->sum[i] = a->count[SAMPLES] ? a->sum[i] + u[i] : u[i];
        a->sum[n + i] = a->count[SAMPLES] ? most(a->sum[n + i], du[i]) : du[i];
    }
    a->count[OUTSIDE] |= outside != 0;
    a->count[SAMPLES]++;
    return live;
}
