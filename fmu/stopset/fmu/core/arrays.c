/* Arrays of FMI 3: the joints' scalars under one value reference. Whoever sets one sets the other. */
#include <stdlib.h>

#include "stopset_fmi.h"

static int is_array(unsigned vr) { return vr >= N_SCALARS && vr - N_SCALARS < N_ARRAYS; }

size_t stopset_elements(const unsigned vr[], size_t n) {
    size_t all = n;
    for (size_t k = 0; k < n; k++) all += is_array(vr[k]) ? NJ - 1 : 0;
    return all;
}

/* The scalars that vr[0], and those behind it that are no array, stand for; *taken: how many variables that are. */
static size_t scalars(const unsigned vr[], size_t n, unsigned block[NJ], const unsigned **first, size_t *taken) {
    *taken = 1;
    if (is_array(vr[0])) {
        for (unsigned i = 0; i < NJ; i++) block[i] = stopset_arrays[vr[0] - N_SCALARS] + i;
        *first = block;
        return NJ;
    }
    while (*taken < n && !is_array(vr[*taken])) (*taken)++;
    *first = vr;
    return *taken;
}

static Level counted(Instance *c, const unsigned vr[], size_t n, size_t size) {
    if (stopset_elements(vr, n) == size) return LEVEL_OK;
    return stopset_fail(c, "get/set", "the number of values is not that of the variables' elements; give one per scalar and joint");
}

Level stopset_get_reals(Instance *c, const unsigned vr[], size_t n, double value[], size_t size) {
    unsigned block[NJ];
    const unsigned *first;
    if (counted(c, vr, n, size)) return LEVEL_ERROR;
    for (size_t k = 0, at = 0, taken; k < n; k += taken) {
        const size_t many = scalars(vr + k, n - k, block, &first, &taken);
        if (stopset_get_real(c, first, many, value + at)) return LEVEL_ERROR;
        at += many;
    }
    return LEVEL_OK;
}

Level stopset_set_reals(Instance *c, const unsigned vr[], size_t n, const double value[], size_t size) {
    unsigned block[NJ];
    const unsigned *first;
    if (counted(c, vr, n, size)) return LEVEL_ERROR;
    for (size_t k = 0, at = 0, taken; k < n; k += taken) {
        const size_t many = scalars(vr + k, n - k, block, &first, &taken);
        if (stopset_set_real(c, first, many, value + at)) return LEVEL_ERROR;
        at += many;
    }
    return LEVEL_OK;
}

static void spread(const unsigned vr[], size_t n, unsigned out[]) {
    unsigned block[NJ];
    const unsigned *first;
    for (size_t k = 0, at = 0, taken; k < n; k += taken) {
        const size_t many = scalars(vr + k, n - k, block, &first, &taken);
        for (size_t i = 0; i < many; i++) out[at++] = first[i];
    }
}

/* The elements of unknowns, then of knowns; to be freed by who asks. 0 with a sentence where the numbers of values are not theirs. */
static unsigned *elements(Instance *c, const Sensitivities *d, size_t of_unknowns, size_t of_knowns) {
    if (stopset_elements(d->unknown, d->unknowns) != of_unknowns || stopset_elements(d->known, d->knowns) != of_knowns) {
        stopset_fail(c, "getDerivative", "as many seeds and sensitivities as elements of the unknowns and knowns are expected; give one per scalar and joint");
        return 0;
    }
    unsigned *all = malloc((of_unknowns + of_knowns + 1) * sizeof *all);
    if (!all) {
        stopset_fail(c, "getDerivative", "no memory left; free instances that are no longer needed");
        return 0;
    }
    spread(d->unknown, d->unknowns, all);
    spread(d->known, d->knowns, all + of_unknowns);
    return all;
}

Level stopset_directional_arrays(Instance *c, const Sensitivities *d) {
    unsigned *all = elements(c, d, d->outs, d->seeds);
    if (!all) return LEVEL_ERROR;
    const Level level = stopset_directional(c, all, d->outs, all + d->outs, d->seeds, d->seed, d->out);
    free(all);
    return level;
}

/* One known at a time: what all unknowns change by, each times its seed. */
Level stopset_adjoint_arrays(Instance *c, const Sensitivities *d) {
    static const double one = 1.0;
    for (size_t i = 0; i < d->seeds; i++)
        if (!stopset_finite(d->seed[i])) return stopset_fail(c, "getAdjointDerivative", "a seed is not a finite number; give finite ones");
    unsigned *all = elements(c, d, d->seeds, d->outs);
    if (!all) return LEVEL_ERROR;
    double *column = malloc((d->seeds + 1) * sizeof *column);
    Level level = column ? LEVEL_OK : stopset_fail(c, "getAdjointDerivative", "no memory left; free instances that are no longer needed");
    for (size_t k = 0; k < d->outs && level == LEVEL_OK; k++) {
        level = stopset_directional(c, all, d->seeds, all + d->seeds + k, 1, &one, column);
        d->out[k] = 0.0;
        for (size_t i = 0; i < d->seeds && level == LEVEL_OK; i++) d->out[k] += d->seed[i] * column[i];
    }
    free(column);
    free(all);
    return level;
}
