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

Level stopset_directional_arrays(Instance *c, const unsigned unknown[], size_t n, const unsigned known[], size_t m, const double seed[],
                                 double out[], size_t seeds, size_t outs) {
    if (stopset_elements(known, m) != seeds || stopset_elements(unknown, n) != outs)
        return stopset_fail(c, "getDirectionalDerivative", "as many seeds as elements of knowns and sensitivities as of unknowns are expected");
    unsigned *all = malloc((seeds + outs + 1) * sizeof *all);
    if (!all) return stopset_fail(c, "getDirectionalDerivative", "no memory left; free instances that are no longer needed");
    spread(unknown, n, all);
    spread(known, m, all + outs);
    const Level level = stopset_directional(c, all, outs, all + outs, seeds, seed, out);
    free(all);
    return level;
}
