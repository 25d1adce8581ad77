/* Loops over many numbers: compiled twice where the system can choose at load, for four numbers at a time and for two. The
 * bits are the same: the wider instructions round as the others do, and no product and sum are contracted. */
#ifndef STOPSET_WIDE_H
#define STOPSET_WIDE_H
#include <string.h> /* says which C library this is */
#if defined(__x86_64__) && defined(__GLIBC__) && !defined(__SANITIZE_ADDRESS__) && !defined(STOPSET_NARROW)
#define STOPSET_WIDE __attribute__((target_clones("avx2", "default")))
#else
#define STOPSET_WIDE
#endif
#endif
