/* An arm's CAN frames to the readings of one SYNC: PDOs taken apart by a table, cycles that are whole and beyond doubt.
 *
 * What is rare, an NMT command, an emergency, a drive that changes its state, is left to the caller.
 *
 * Source: CiA 301 for SYNC, PDO and heartbeat, CiA 402 for the statusword.
 */
#include <math.h>
#include <string.h>

#include "stopset.h"

static const double shortest_period = 2e-5, near = 60.0, leak = 1e-3, latest = 0.9, hold = 0.2;

/* When a frame was on the wire by this machine's clock [s]; which clock stamps them is decided at the first one. */
static double stamped(StopsetDecoder *d, double t, double now) {
    if (!(t - t == 0.0)) return 0.0; /* not a number: as old as can be */
    if (d->foreign < 0) {
        d->foreign = t - now > near || now - t > near;
        d->shifted = now;
    }
    if (!d->foreign) return t;
    /* by the least delay seen, so that no frame looks younger than it is but for the clocks' drift */
    const double passed = now > d->shifted ? now - d->shifted : 0.0, drifted = d->shift + leak * passed;
    d->shift = drifted < now - t ? drifted : now - t;
    d->shifted = now;
    return t + d->shift;
}

static double number(int kind, const uint8_t *data) {
    uint64_t bits = 0;
    static const int bytes[] = {1, 2, 4, 8, 1, 2, 4, 8, 4, 8, 1};
    for (int k = 0; k < bytes[kind]; k++) bits |= (uint64_t)data[k] << 8 * k;
    const uint64_t sign = (uint64_t)1 << (8 * bytes[kind] - 1);
    float single;
    double whole;
    uint32_t half = (uint32_t)bits;
    switch (kind) {
    case STOPSET_I8:
    case STOPSET_I16:
    case STOPSET_I32:
    case STOPSET_I64: return bits & sign ? -(double)(~bits & (sign - 1)) - 1.0 : (double)bits;
    case STOPSET_F32: memcpy(&single, &half, sizeof single); return single;
    case STOPSET_F64: memcpy(&whole, &bits, sizeof whole); return whole;
    case STOPSET_BOOL: return bits != 0;
    default: return (double)bits;
    }
}

static void spoilt(StopsetDecoder *d) {
    d->incomplete++;
    d->doubtful = 1;
    d->holds = 0;
    d->hold = (int32_t)(hold / d->cycle_s + 0.5);
}

/* "Operation enabled" in a statusword; where none is carried nothing speaks against it. */
static int in_operation(double word) { return word != word || (fabs(word) < 0x1p31 && ((int64_t)word & 0x6f) == 0x27); }

/* The cycle in `values` is given out. */
static void give(StopsetDecoder *d, int32_t counter, double t) {
    d->out_counter = counter;
    d->out_t = t;
    d->out_lacks = 0;
    d->out_powered = 1;
    for (int s = 0; s < d->signals; s++)
        for (int i = 0; i < d->n; i++) {
            const double x = d->values[s * d->n + i];
            if (x != x) d->out_lacks |= (uint32_t)1 << s;
            if (s == d->status && !in_operation(x)) d->out_powered = 0;
        }
}

/* The held cycle, if no frame came twice, no SYNC is missing, and this one does not come with its last frame. */
static int next_sync(StopsetDecoder *d, const StopsetFrame *f, double t) {
    int given = d->holds;
    d->holds = 0;
    if (d->hold > 0) d->hold--;
    if (d->synced && d->seen < d->synchronous) spoilt(d);
    const int counter = f->length > 0 ? f->data[0] : -1, before = d->held_counter;
    const int lost = d->overflow && before >= 0 ? counter != before % d->overflow + 1 : !d->overflow && t - d->held_t > 1.5 * d->cycle_s;
    if (given && (lost || t - d->held_at < shortest_period)) {
        given = 0;
        spoilt(d);
    }
    d->syncs++;
    d->synced = 1;
    d->counter = counter;
    d->t = t;
    d->seen = 0;
    memset(d->came, 0, (size_t)d->pdos);
    if (given) {
        memcpy(d->values, d->held, (size_t)(d->signals * d->n) * sizeof *d->values);
        give(d, d->held_counter, d->held_t);
    }
    return given;
}

static void unpack_pdo(StopsetDecoder *d, const StopsetPdo *p, const StopsetFrame *f) {
    const StopsetField *field = d->field + p->first;
    for (int k = 0; k < p->count; k++) d->raw[field[k].target] = number(field[k].kind, f->data + field[k].offset);
}

static int pdo(StopsetDecoder *d, int place, const StopsetFrame *f, double t) {
    const StopsetPdo *p = d->pdo + place;
    if (!p->synchronous) { /* a drive tells what has changed; it holds until it tells again */
        if (f->length != p->length) d->incomplete++;
        else unpack_pdo(d, p, f);
        return 0;
    }
    if (!d->synced) { /* heard before any SYNC: the next cycle may hold a late one of these */
        d->doubtful = 1;
        return 0;
    }
    if (d->came[place] || f->length != p->length) {
        spoilt(d);
        d->synced = 0;
        return 0;
    }
    d->came[place] = 1;
    d->seen++;
    unpack_pdo(d, p, f);
    if (d->seen < d->synchronous) return 0;
    int late = t - d->t > latest * d->cycle_s;
    if (d->doubtful) { /* what ends it late may be the next one's: then that is no better */
        d->doubtful = late;
        d->doubted++;
        return 0;
    }
    late |= d->hold > 0;
    double *out = late ? d->held : d->values;
    for (int k = 0; k < d->signals * d->n; k++) out[k] = d->raw[k] * d->scale[k];
    if (late) {
        d->holds = 1;
        d->held_at = t;
        d->held_counter = d->counter;
        d->held_t = d->t;
    } else {
        give(d, d->counter, d->t);
    }
    return !late;
}

int stopset_nodes_good(const StopsetDecoder *d, double now) {
    for (int k = 0; k < STOPSET_NODES; k++) {
        if (d->node[k] == STOPSET_STRANGER) continue;
        /* one stamped far ahead, or before the clock was set back, says nothing of now */
        if (d->node[k] == STOPSET_BAD || (d->patience != 0.0 && !(fabs(now - d->heard[k]) <= d->patience))) return 0;
    }
    return 1;
}

/* Of a service: heartbeats of nodes that go on as they were are taken in here. */
static int service(StopsetDecoder *d, const StopsetFrame *f, double t) {
    d->unknown++;
    if (f->id > 0x700 && f->id < 0x700 + STOPSET_NODES) {
        const uint32_t node = f->id - 0x700;
        if (d->node[node] != STOPSET_GOOD || f->length != 1 || (f->data[0] & 0x7f) != 5) return d->node[node] != STOPSET_STRANGER;
        d->heard[node] = t;
        return 0;
    }
    return f->id == 0 || (f->id > 0x80 && f->id < 0x100);
}

int stopset_decode(StopsetDecoder *d, const StopsetFrame *frames, int64_t count, double now, int64_t *taken) {
    while (*taken < count) {
        const StopsetFrame *f = frames + (*taken)++;
        const double t = stamped(d, f->t, now);
        const int place = f->id < STOPSET_IDS ? d->place[f->id] : -1;
        StopsetFrame *entry = d->log + d->frames++ % d->room;
        *entry = *f;
        entry->t = t;
        if (place == STOPSET_SYNC ? next_sync(d, f, t) : place >= 0 && pdo(d, place, f, t)) {
            d->nodes_good = stopset_nodes_good(d, now);
            return STOPSET_CYCLE;
        }
        if (place == -1 && service(d, f, t)) return STOPSET_SERVICE;
    }
    return 0;
}
