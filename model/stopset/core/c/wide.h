/* Loops over many numbers: compiled twice where the system can choose at load, for four numbers at a time and for two. The
 * bits are the same: the wider instructions round as the others do, and no product and sum are contracted. */
#ifndef STOPSET_WIDE_H
#define STOPSET_WIDE_H
#include <stdint.h>
#include <string.h> /* says which C library this is */

/* Four numbers at a time, in whatever instructions the machine has; numbers in a row may be seen so. */
typedef double Four __attribute__((vector_size(32), aligned(8), may_alias));
typedef int64_t Choice __attribute__((vector_size(32), aligned(8), may_alias));
#define SIZES_OF(x) ((Four)((Choice)(x)&INT64_MAX))                    /* their sizes: the sign is a bit */
#define CHOSEN(c, x, y) ((Four)(((c) & (Choice)(x)) | (~(c) & (Choice)(y)))) /* x where c, else y */
#define BELOW(x, y) CHOSEN((y) < (x), y, x) /* as `least` and `most` */
#define ABOVE(x, y) CHOSEN((y) > (x), y, x)
#define FOUR_OF(x) ((Four){(x), (x), (x), (x)})
#define LANES_FROM(first) ((Choice){0, 1, 2, 3} + (first))                     /* which four they are */
#define IN_LANES(bits) (((Choice){1, 2, 4, 8} & (int64_t)(bits)) != 0) /* all bits or none, from a bit each */

/* STOPSET_PROCESSOR: processor.c is linked too, which answers where no library of the system does. */
#if defined(__x86_64__) && (defined(__GLIBC__) || defined(STOPSET_PROCESSOR)) && !defined(__SANITIZE_ADDRESS__) && !defined(STOPSET_NARROW)
#define STOPSET_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define STOPSET_WIDE
#endif

/* Where n is a number loops become straight lines: what most arms spend their time in is compiled for their joints once more. f(n, ...), without a value. */
enum { USUAL_JOINTS = 6, REDUNDANT_JOINTS = 7 };
#if defined(__GNUC__) && !defined(STOPSET_NARROW)
#define UNROLLED static inline __attribute__((always_inline))
#define SIZED(f, n, ...) \
    ((n) == USUAL_JOINTS ? f(USUAL_JOINTS, __VA_ARGS__) : (n) == REDUNDANT_JOINTS ? f(REDUNDANT_JOINTS, __VA_ARGS__) : f(n, __VA_ARGS__))
#else
#define UNROLLED static inline
#define SIZED(f, n, ...) f(n, __VA_ARGS__)
#endif
#endif
