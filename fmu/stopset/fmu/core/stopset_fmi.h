/* What FMI 2 and FMI 3 share: the instance, access to variables, stepping, saved states, messages. */
#ifndef STOPSET_FMI_H
#define STOPSET_FMI_H

#include <stddef.h>

#include "stopset_core.h"

typedef enum { PHASE_CREATED, PHASE_INITIALIZATION, PHASE_EVENT, PHASE_CONTINUOUS, PHASE_STEP, PHASE_TERMINATED, PHASE_BETWEEN } Phase;
typedef enum { LEVEL_OK, LEVEL_WARNING, LEVEL_ERROR } Level;

/* A saved state: plain data, so a copy restores everything. */
typedef struct {
    StopsetState s;
    double t0;
    int32_t phase, stale;
} Saved;

typedef struct Instance Instance;
struct Instance {
    Saved now;
    StopsetWork *work; /* what follows from the parameters; nothing in it is part of the state */
    Saved *spare;      /* three states, for derivatives */
    int co_simulation, logging;
    int event_mode;    /* whether co-simulation has one, FMI 3 */
    void *environment;
    void (*write)(Instance *, Level, const char *message);
    void *callback, *update; /* of messages, and of times within a step */
    char name[256];
};

Instance *stopset_create(const char *name, const char *token, int co_simulation, int logging, void *environment, void *callback,
                         void (*write)(Instance *, Level, const char *));
/* All return LEVEL_OK or have said in one sentence what is wrong. */
Level stopset_fail(Instance *c, const char *function, const char *what);
Level stopset_expect(Instance *c, const char *function, unsigned phases);
Level stopset_enter_initialization(Instance *c, double t0);
Level stopset_exit_initialization(Instance *c);
Level stopset_get_real(Instance *c, const unsigned vr[], size_t n, double value[]);
Level stopset_get_integer(Instance *c, const unsigned vr[], size_t n, int32_t value[]);
Level stopset_get_boolean(Instance *c, const unsigned vr[], size_t n, uint8_t value[]);
Level stopset_set_real(Instance *c, const unsigned vr[], size_t n, const double value[]);
Level stopset_set_integer(Instance *c, const unsigned vr[], size_t n, const int32_t value[]);
Level stopset_set_boolean(Instance *c, const unsigned vr[], size_t n, const uint8_t value[]);
/* Elements of variables, arrays' included; access to them, `size` values in all. */
size_t stopset_elements(const unsigned vr[], size_t n);
Level stopset_get_reals(Instance *c, const unsigned vr[], size_t n, double value[], size_t size);
Level stopset_set_reals(Instance *c, const unsigned vr[], size_t n, const double value[], size_t size);
/* A clock that asks for a stop, 0 STOP 0 to 2 STOP 2, ticks. */
Level stopset_tick(Instance *c, unsigned clock, int active);
Level stopset_do_step(Instance *c, double t, double h);
Level stopset_get_state(Instance *c, void **state);
Level stopset_set_state(Instance *c, const void *state);
size_t stopset_serialized_size(void);
Level stopset_serialize(Instance *c, const void *state, unsigned char *bytes, size_t size);
Level stopset_deserialize(Instance *c, const unsigned char *bytes, size_t size, void **state);
void stopset_free(Instance *c);
void stopset_reset(Instance *c);
/* What the unknowns change by per change of the knowns along `seed`: central differences, friction directions held. */
Level stopset_directional(Instance *c, const unsigned unknown[], size_t n, const unsigned known[], size_t m, const double seed[], double out[]);
/* Derivatives of `unknowns` variables by `knowns`, arrays among them: of seeds along the knowns, or, of the adjoint, of the unknowns. */
typedef struct {
    const unsigned *unknown, *known;
    size_t unknowns, knowns, seeds, outs;
    const double *seed;
    double *out;
} Sensitivities;
Level stopset_directional_arrays(Instance *c, const Sensitivities *d);
Level stopset_adjoint_arrays(Instance *c, const Sensitivities *d);
/* Model exchange. */
Level stopset_set_time(Instance *c, double t);
Level stopset_set_states(Instance *c, const double x[], size_t n);
Level stopset_get_states(Instance *c, double x[], size_t n);
Level stopset_get_derivatives(Instance *c, double dx[], size_t n);
enum { N_INDICATORS = HAS_INDICATORS ? NJ : 0 };
Level stopset_get_indicators(Instance *c, double z[], size_t n);
Level stopset_completed_step(Instance *c, int *event); /* `event`: whether one has to be handled */
Level stopset_update_discrete(Instance *c, int *states_changed, int *next_defined, double *next);

#define IN(phase) (1u << (phase))
#define RUNNING (IN(PHASE_EVENT) | IN(PHASE_CONTINUOUS) | IN(PHASE_STEP))

#endif
