/* What the library was made from. */
#include "stopset.h"

#ifndef STOPSET_SOURCES
#define STOPSET_SOURCES "not stated"
#endif

const char *stopset_sources(void) { return STOPSET_SOURCES; }
