/* Function blocks for control programs in C.
 *
 * The same blocks as the Rust crate takt-blocks, with the same structures and the same results; the table
 * of all blocks, their formulas and references is docs/blocks.md. Everything is in this header, so it builds
 * with any C11 compiler for x86-64, freestanding and without a library. Do not use -ffast-math: it takes
 * away what the blocks know of NaN and infinity.
 *
 * A block is a structure and a function takt_NAME_update. A structure with all bytes zero is the cold
 * start; its parameters (the members before "state") are set by an initialiser and may be changed at any
 * time. Call each block once in a scan. elapsed_ns is the time since its last call in nanoseconds, such as
 * period_ns of the task information.
 *
 * A number that is not finite stays out of the state: a block with memory ignores it and keeps its output,
 * a block without memory hands it on. Exceptions are stated at the block.
 */
#ifndef TAKT_BLOCKS_H
#define TAKT_BLOCKS_H

#include <emmintrin.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* ---- Arithmetic ---- */

static inline bool takt_is_finite(double value) {
    return value - value == 0.0;
}

static inline double takt_square_root(double value) {
    const __m128d wide = _mm_set_sd(value);
    return _mm_cvtsd_f64(_mm_sqrt_sd(wide, wide));
}

static inline double takt_seconds(uint64_t nanoseconds) {
    return (double)(nanoseconds / 1000000000u) + (double)(nanoseconds % 1000000000u) / 1e9;
}

static inline uint64_t takt_time_sum(uint64_t a, uint64_t b) {
    return a + b < a ? UINT64_MAX : a + b;
}

static inline uint64_t takt_time_least(uint64_t a, uint64_t b) {
    return a < b ? a : b;
}

/* MIN(MAX(value, low), high). NaN is handed on; a limit that is NaN is none. */
static inline double takt_limit(double low, double value, double high) {
    const double raised = value < low ? low : value;
    return raised > high ? high : raised;
}

/* ---- Timers of IEC 61131-3; times in nanoseconds ---- */

struct takt_ton {
    uint64_t et; /* state: time since the input rose */
    bool running;
    bool q;
};

static inline bool takt_ton_update(struct takt_ton *b, bool in, uint64_t pt, uint64_t elapsed_ns) {
    b->et = in && b->running ? takt_time_least(takt_time_sum(b->et, elapsed_ns), pt) : 0;
    b->running = in;
    b->q = in && b->et >= pt;
    return b->q;
}

struct takt_tof {
    uint64_t et; /* state: time since the input fell */
    bool running;
    bool q;
};

static inline bool takt_tof_update(struct takt_tof *b, bool in, uint64_t pt, uint64_t elapsed_ns) {
    if (in) {
        b->et = 0;
        b->running = false;
        b->q = true;
    } else if (b->q) {
        if (b->running)
            b->et = takt_time_sum(b->et, elapsed_ns);
        b->et = takt_time_least(b->et, pt);
        b->running = true;
        b->q = b->et < pt;
    }
    return b->q;
}

struct takt_tp {
    uint64_t et; /* state: time since the pulse began */
    bool last_input;
    bool q;
};

static inline bool takt_tp_update(struct takt_tp *b, bool in, uint64_t pt, uint64_t elapsed_ns) {
    if (b->q) {
        b->et = takt_time_least(takt_time_sum(b->et, elapsed_ns), pt);
        b->q = b->et < pt;
    }
    if (!b->q) {
        if (in && !b->last_input) {
            b->et = 0;
            b->q = pt > 0;
        } else if (!in) {
            b->et = 0;
        }
    }
    b->last_input = in;
    return b->q;
}

/* ---- Edges and bistable blocks of IEC 61131-3 ---- */

struct takt_r_trig {
    bool memory; /* state */
    bool q;
};

static inline bool takt_r_trig_update(struct takt_r_trig *b, bool clk) {
    b->q = clk && !b->memory;
    b->memory = clk;
    return b->q;
}

struct takt_f_trig {
    bool memory; /* state */
    bool q;
};

static inline bool takt_f_trig_update(struct takt_f_trig *b, bool clk) {
    b->q = !clk && !b->memory;
    b->memory = !clk;
    return b->q;
}

struct takt_sr {
    bool q1; /* state */
};

static inline bool takt_sr_update(struct takt_sr *b, bool s1, bool r) {
    b->q1 = s1 || (!r && b->q1);
    return b->q1;
}

struct takt_rs {
    bool q1; /* state */
};

static inline bool takt_rs_update(struct takt_rs *b, bool s, bool r1) {
    b->q1 = !r1 && (s || b->q1);
    return b->q1;
}

/* ---- Counters of IEC 61131-3: takt_ctu (INT), takt_ctu_dint, ..._lint, ..._udint, ..._ulint ---- */

#define TAKT_COUNTERS(SUFFIX, TYPE, LEAST, GREATEST)                                                         \
    struct takt_ctu##SUFFIX {                                                                                \
        TYPE cv; /* state */                                                                                 \
        struct takt_r_trig edge;                                                                             \
        bool q;                                                                                              \
    };                                                                                                       \
    static inline bool takt_ctu##SUFFIX##_update(struct takt_ctu##SUFFIX *b, bool cu, bool r, TYPE pv) {     \
        const bool up = takt_r_trig_update(&b->edge, cu);                                                    \
        if (r)                                                                                               \
            b->cv = 0;                                                                                       \
        else if (up && b->cv < (GREATEST))                                                                   \
            b->cv++;                                                                                         \
        b->q = b->cv >= pv;                                                                                  \
        return b->q;                                                                                         \
    }                                                                                                        \
    struct takt_ctd##SUFFIX {                                                                                \
        TYPE cv; /* state */                                                                                 \
        struct takt_r_trig edge;                                                                             \
        bool q;                                                                                              \
    };                                                                                                       \
    static inline bool takt_ctd##SUFFIX##_update(struct takt_ctd##SUFFIX *b, bool cd, bool ld, TYPE pv) {    \
        const bool down = takt_r_trig_update(&b->edge, cd);                                                  \
        if (ld)                                                                                              \
            b->cv = pv;                                                                                      \
        else if (down && b->cv > (LEAST))                                                                    \
            b->cv--;                                                                                         \
        b->q = b->cv <= 0;                                                                                   \
        return b->q;                                                                                         \
    }                                                                                                        \
    struct takt_ctud##SUFFIX {                                                                               \
        TYPE cv; /* state */                                                                                 \
        struct takt_r_trig up_edge;                                                                          \
        struct takt_r_trig down_edge;                                                                        \
        bool qu;                                                                                             \
        bool qd;                                                                                             \
    };                                                                                                       \
    static inline void takt_ctud##SUFFIX##_update(struct takt_ctud##SUFFIX *b, bool cu, bool cd, bool r,     \
                                                  bool ld, TYPE pv) {                                        \
        const bool up = takt_r_trig_update(&b->up_edge, cu);                                                 \
        const bool down = takt_r_trig_update(&b->down_edge, cd);                                             \
        if (r)                                                                                               \
            b->cv = 0;                                                                                       \
        else if (ld)                                                                                         \
            b->cv = pv;                                                                                      \
        else if (up && !down && b->cv < (GREATEST))                                                          \
            b->cv++;                                                                                         \
        else if (down && !up && b->cv > (LEAST))                                                             \
            b->cv--;                                                                                         \
        b->qu = b->cv >= pv;                                                                                 \
        b->qd = b->cv <= 0;                                                                                  \
    }

TAKT_COUNTERS(, int16_t, INT16_MIN, INT16_MAX)
TAKT_COUNTERS(_dint, int32_t, INT32_MIN, INT32_MAX)
TAKT_COUNTERS(_lint, int64_t, INT64_MIN, INT64_MAX)
TAKT_COUNTERS(_udint, uint32_t, 0, UINT32_MAX)
TAKT_COUNTERS(_ulint, uint64_t, 0, UINT64_MAX)

/* ---- Blocks without memory ---- */

struct takt_limiter {
    double low, high;
    bool at_low, at_high; /* state */
};

static inline double takt_limiter_update(struct takt_limiter *b, double value) {
    b->at_high = value > b->high;
    b->at_low = value < b->low && !b->at_high;
    return takt_limit(b->low, value, b->high);
}

struct takt_dead_band {
    double width;
};

static inline double takt_dead_band_update(const struct takt_dead_band *b, double value) {
    if (value > b->width)
        return value - b->width;
    if (value < -b->width)
        return value + b->width;
    return value * 0.0; /* NaN is neither above nor below. */
}

struct takt_scale {
    double in_low, in_high, out_low, out_high;
};

static inline double takt_scale_update(const struct takt_scale *b, double value) {
    const double span = b->in_high - b->in_low;
    if (value != value)
        return value;
    if (span == 0.0)
        return b->out_low;
    return b->out_low + (value - b->in_low) / span * (b->out_high - b->out_low);
}

/* ---- Hysteresis: NaN changes nothing ---- */

struct takt_hysteresis {
    double low, high;
    bool output; /* state */
};

static inline bool takt_hysteresis_update(struct takt_hysteresis *b, double value) {
    if (value > b->high)
        b->output = true;
    else if (value < b->low)
        b->output = false;
    return b->output;
}

/* ---- Multiplexer: a number out of range keeps the input that was selected last ---- */

struct takt_multiplexer {
    uint32_t selected; /* state */
    bool out_of_range;
};

/* count is at least 1. */
static inline double takt_multiplexer_update(struct takt_multiplexer *b, uint32_t select, const double *inputs,
                                             size_t count) {
    b->out_of_range = select >= count;
    if (!b->out_of_range)
        b->selected = select;
    return inputs[b->selected < count ? b->selected : count - 1];
}

/* ---- Filters and ramp by elapsed time ---- */

struct takt_lag {
    double time_constant; /* seconds; at zero or less the output is the input */
    double output;        /* state */
    bool started;
};

static inline double takt_lag_update(struct takt_lag *b, double input, uint64_t elapsed_ns) {
    const double seconds = takt_seconds(elapsed_ns);
    double next = input;
    if (!takt_is_finite(input))
        return b->output;
    if (b->started && b->time_constant > 0.0)
        next = b->output + (input - b->output) * (seconds / (b->time_constant + seconds));
    if (takt_is_finite(next)) {
        b->output = next;
        b->started = true;
    }
    return b->output;
}

struct takt_second_order {
    double frequency; /* rad/s; at zero or less the output is the input */
    double damping;
    double output; /* state */
    double rate;
    bool started;
};

static inline double takt_second_order_update(struct takt_second_order *b, double input, uint64_t elapsed_ns) {
    const double seconds = takt_seconds(elapsed_ns);
    double rate = 0.0, output = input;
    if (!takt_is_finite(input))
        return b->output;
    if (b->started && b->frequency > 0.0) {
        const double turn = b->frequency * seconds;
        const double pull = turn * b->frequency * (input - b->output);
        rate = (b->rate + pull) / (1.0 + 2.0 * b->damping * turn + turn * turn);
        output = b->output + rate * seconds;
    }
    if (takt_is_finite(rate) && takt_is_finite(output)) {
        b->rate = rate;
        b->output = output;
        b->started = true;
    }
    return b->output;
}

struct takt_ramp {
    double up, down; /* units per second */
    double output;   /* state */
};

static inline double takt_ramp_update(struct takt_ramp *b, double input, uint64_t elapsed_ns) {
    const double distance = input - b->output;
    const double reach = (distance > 0.0 ? b->up : b->down) * takt_seconds(elapsed_ns);
    if (!takt_is_finite(distance))
        return b->output;
    if ((distance < 0.0 ? -distance : distance) <= reach)
        b->output = input;
    else if (reach > 0.0)
        b->output += distance > 0.0 ? reach : -reach;
    return b->output;
}

/* ---- Filters for a fixed period ---- */

struct takt_coefficients {
    double b0, b1, b2, a1, a2;
};

struct takt_biquad {
    struct takt_coefficients coefficients;
    double state[2]; /* state */
    double output;
};

static inline double takt_biquad_update(struct takt_biquad *b, double input) {
    const struct takt_coefficients c = b->coefficients;
    const double output = c.b0 * input + b->state[0];
    const double first = c.b1 * input - c.a1 * output + b->state[1];
    const double second = c.b2 * input - c.a2 * output;
    if (takt_is_finite(output) && takt_is_finite(first) && takt_is_finite(second)) {
        b->state[0] = first;
        b->state[1] = second;
        b->output = output;
    }
    return b->output;
}

/* Sine and cosine of an angle from 0 to pi, within 2e-15: Taylor series at a sixteenth of the angle, then the
 * formulas of the double angle. versine is 1 - cos. */
static inline void takt_sine_and_versine(double angle, double *sine, double *versine) {
    const double small = angle / 16.0, square = small * small;
    double s = 1.0, v = 1.0;
    int k;
    for (k = 6; k >= 1; k--) {
        s = 1.0 - square / (2.0 * k * (2.0 * k + 1.0)) * s;
        v = 1.0 - square / ((2.0 * k + 1.0) * (2.0 * k + 2.0)) * v;
    }
    s *= small;
    v *= square / 2.0;
    for (k = 0; k < 4; k++) {
        const double next = 2.0 * s * (1.0 - v);
        v = 2.0 * s * s;
        s = next;
    }
    *sine = s;
    *versine = v;
}

enum takt_pass { TAKT_LOW_PASS, TAKT_HIGH_PASS, TAKT_BAND_PASS, TAKT_NOTCH };

/* frequency is the corner or centre divided by the sampling frequency, above 0 and below 0.5; quality is
 * positive, and 0.70710678 for a Butterworth filter. */
static inline struct takt_coefficients takt_design(enum takt_pass pass, double frequency, double quality) {
    double sine, versine, cosine, alpha, a0, b0, b1, b2;
    takt_sine_and_versine(6.283185307179586 * frequency, &sine, &versine);
    cosine = 1.0 - versine;
    alpha = sine / (2.0 * quality);
    a0 = 1.0 + alpha;
    switch (pass) {
    case TAKT_LOW_PASS:
        b1 = 1.0 - cosine;
        b0 = b2 = b1 / 2.0;
        break;
    case TAKT_HIGH_PASS:
        b1 = -(1.0 + cosine);
        b0 = b2 = -b1 / 2.0;
        break;
    case TAKT_BAND_PASS:
        b0 = alpha;
        b1 = 0.0;
        b2 = -alpha;
        break;
    default:
        b0 = b2 = 1.0;
        b1 = -2.0 * cosine;
        break;
    }
    return (struct takt_coefficients){b0 / a0, b1 / a0, b2 / a0, -2.0 * cosine / a0, (1.0 - alpha) / a0};
}

/* struct NAME, a FIR filter of N coefficients, and double NAME_update(struct NAME *, double). */
#define TAKT_FIR(NAME, N)                                                                                    \
    struct NAME {                                                                                            \
        double coefficients[N];                                                                              \
        double history[N]; /* state */                                                                       \
        double output;                                                                                       \
        uint32_t newest;                                                                                     \
    };                                                                                                       \
    static inline double NAME##_update(struct NAME *b, double input) {                                       \
        const uint32_t newest = (b->newest == 0 || b->newest > (N) ? (N) : b->newest) - 1;                   \
        double output = 0.0;                                                                                 \
        uint32_t k;                                                                                          \
        if (!takt_is_finite(input))                                                                          \
            return b->output;                                                                                \
        b->history[newest] = input;                                                                          \
        b->newest = newest;                                                                                  \
        for (k = 0; k < (N); k++)                                                                            \
            output += b->coefficients[k] * b->history[(newest + k) % (N)];                                   \
        if (takt_is_finite(output))                                                                          \
            b->output = output;                                                                              \
        return b->output;                                                                                    \
    }

/* struct NAME, a delay of up to N calls, and double NAME_update(struct NAME *, double). NaN and infinity
 * are delayed as any number. */
#define TAKT_DELAY(NAME, N)                                                                                  \
    struct NAME {                                                                                            \
        uint32_t calls;                                                                                      \
        uint32_t newest; /* state */                                                                         \
        uint32_t held;                                                                                       \
        double history[N];                                                                                   \
    };                                                                                                       \
    static inline double NAME##_update(struct NAME *b, double input) {                                       \
        const uint32_t newest = b->newest % (N), room = b->held < (N) ? b->held : (N);                       \
        const uint32_t back = b->calls < room ? b->calls : room;                                             \
        const double output = back == 0 ? input : b->history[(newest + (N) + 1 - back) % (N)];               \
        b->newest = (newest + 1) % (N);                                                                      \
        b->history[b->newest] = input;                                                                       \
        b->held = room < (N) ? room + 1 : (N);                                                               \
        return output;                                                                                       \
    }

/* ---- Moving statistics ---- */

/* struct NAME, statistics over the last N values. NAME_update takes a value in; NAME_mean,
 * NAME_standard_deviation, NAME_least and NAME_greatest are those of the values so far, 0 without any. */
#define TAKT_STATISTICS(NAME, N)                                                                             \
    struct NAME {                                                                                            \
        uint32_t newest; /* state */                                                                         \
        uint32_t held;                                                                                       \
        double values[N];                                                                                    \
    };                                                                                                       \
    static inline uint32_t NAME##_count(const struct NAME *b) { return b->held < (N) ? b->held : (N); }      \
    static inline void NAME##_update(struct NAME *b, double value) {                                         \
        const uint32_t newest = b->newest % (N);                                                             \
        if (!takt_is_finite(value))                                                                          \
            return;                                                                                          \
        b->values[newest] = value;                                                                           \
        b->newest = (newest + 1) % (N);                                                                      \
        b->held = b->held < (N) ? b->held + 1 : (N);                                                         \
    }                                                                                                        \
    static inline double NAME##_mean(const struct NAME *b) {                                                 \
        return takt_mean(b->values, NAME##_count(b));                                                        \
    }                                                                                                        \
    static inline double NAME##_standard_deviation(const struct NAME *b) {                                   \
        return takt_square_root(takt_variance(b->values, NAME##_count(b)));                                  \
    }                                                                                                        \
    static inline double NAME##_least(const struct NAME *b) {                                                \
        return takt_extreme(b->values, NAME##_count(b), false);                                              \
    }                                                                                                        \
    static inline double NAME##_greatest(const struct NAME *b) {                                             \
        return takt_extreme(b->values, NAME##_count(b), true);                                               \
    }

static inline double takt_mean(const double *values, uint32_t count) {
    double sum = 0.0;
    uint32_t k;
    for (k = 0; k < count; k++)
        sum += values[k];
    return count == 0 ? 0.0 : sum / count;
}

static inline double takt_variance(const double *values, uint32_t count) {
    const double mean = takt_mean(values, count);
    double sum = 0.0;
    uint32_t k;
    for (k = 0; k < count; k++)
        sum += (values[k] - mean) * (values[k] - mean);
    return count < 2 ? 0.0 : sum / (count - 1);
}

static inline double takt_extreme(const double *values, uint32_t count, bool greatest) {
    double extreme = count == 0 ? 0.0 : values[0];
    uint32_t k;
    for (k = 1; k < count; k++)
        if (greatest ? values[k] > extreme : values[k] < extreme)
            extreme = values[k];
    return extreme;
}

/* ---- PID controller ---- */

struct takt_pid_tuning {
    double proportional;      /* output per unit of deviation */
    double integral;          /* output per unit of deviation and second */
    double derivative;        /* output per unit per second */
    double derivative_filter; /* time constant in seconds; 0 is none */
    double low, high;         /* limits of the output; NaN is none */
};

struct takt_pid {
    struct takt_pid_tuning tuning;
    double integral_part; /* state */
    double slope;
    double last_measured;
    double output;
    bool started;
};

static inline double takt_pid_direct(struct takt_pid *b, double set, double measured, double seconds) {
    const double filter = b->tuning.derivative_filter;
    if (b->started && seconds > 0.0) {
        const double slope = (measured - b->last_measured) / seconds;
        const double next =
            filter > 0.0 ? b->slope + (slope - b->slope) * (seconds / (filter + seconds)) : slope;
        if (takt_is_finite(next))
            b->slope = next;
    } else if (filter <= 0.0) {
        b->slope = 0.0;
    }
    b->last_measured = measured;
    b->started = true;
    return b->tuning.proportional * (set - measured) - b->tuning.derivative * b->slope;
}

/* A step that changes nothing. Its time is in no slope: from the last measured value to the next one more passes
 * than elapsed_ns will say then. */
static inline double takt_pid_miss(struct takt_pid *b) {
    b->started = false;
    return b->output;
}

static inline double takt_pid_keep(struct takt_pid *b, double output) {
    if (takt_is_finite(output))
        b->output = output;
    return b->output;
}

/* Automatic control. After an argument that is not finite the next call takes no new slope. */
static inline double takt_pid_update(struct takt_pid *b, double set, double measured, uint64_t elapsed_ns) {
    const double seconds = takt_seconds(elapsed_ns), low = b->tuning.low, high = b->tuning.high;
    double direct, change, integral, output;
    if (!takt_is_finite(set) || !takt_is_finite(measured))
        return takt_pid_miss(b);
    direct = takt_pid_direct(b, set, measured, seconds);
    change = b->tuning.integral * (set - measured) * seconds;
    /* An integral that came from manual control may be out of range: it may return, not go further. */
    integral = takt_limit(b->integral_part < low ? b->integral_part : low, b->integral_part + change,
                          b->integral_part > high ? b->integral_part : high);
    output = direct + integral;
    if (!(output > high && change > 0.0) && !(output < low && change < 0.0) && takt_is_finite(integral))
        b->integral_part = integral;
    return takt_pid_keep(b, takt_limit(low, output, high));
}

/* Manual control: the output is manual, limited; automatic control begins there without a bump. */
static inline double takt_pid_track(struct takt_pid *b, double manual, double set, double measured,
                                    uint64_t elapsed_ns) {
    double direct, output;
    if (!takt_is_finite(manual) || !takt_is_finite(set) || !takt_is_finite(measured))
        return takt_pid_miss(b);
    direct = takt_pid_direct(b, set, measured, takt_seconds(elapsed_ns));
    output = takt_limit(b->tuning.low, manual, b->tuning.high);
    if (takt_is_finite(output - direct))
        b->integral_part = output - direct;
    return takt_pid_keep(b, output);
}

/* ---- Alarm ---- */

enum takt_condition { TAKT_ABOVE, TAKT_BELOW, TAKT_EQUAL, TAKT_DIFFERENT };

enum takt_alarm_state {
    TAKT_NORMAL,
    TAKT_UNACKNOWLEDGED,
    TAKT_ACKNOWLEDGED,
    TAKT_RETURNED_UNACKNOWLEDGED
};

struct takt_alarm {
    enum takt_condition condition;
    double limit, dead_band;
    uint64_t on_delay, off_delay; /* nanoseconds */
    uint64_t waited;              /* state */
    enum takt_alarm_state state;
    bool raw;
    bool held; /* whether the last number fulfilled the condition */
    bool last_acknowledge;
};

static inline bool takt_alarm_holds(const struct takt_alarm *b, double value) {
    const double back = b->held ? b->dead_band : 0.0;
    const double distance = value < b->limit ? b->limit - value : value - b->limit;
    switch (b->condition) {
    case TAKT_ABOVE:
        return value > b->limit - back;
    case TAKT_BELOW:
        return value < b->limit + back;
    case TAKT_EQUAL:
        return distance <= b->dead_band;
    default:
        return distance > b->dead_band;
    }
}

/* NaN fulfils every condition, and leaves the dead band as it was. acknowledge counts when it rises. */
static inline enum takt_alarm_state takt_alarm_update(struct takt_alarm *b, double value, bool acknowledge,
                                                      uint64_t elapsed_ns) {
    const bool is_nan = value != value;
    const bool raw = is_nan || takt_alarm_holds(b, value);
    const bool seen = acknowledge && !b->last_acknowledge;
    bool active = b->state == TAKT_UNACKNOWLEDGED || b->state == TAKT_ACKNOWLEDGED;
    b->waited = raw == b->raw ? takt_time_sum(b->waited, elapsed_ns) : 0;
    if (b->waited >= (raw ? b->on_delay : b->off_delay))
        active = raw;
    if (active) {
        if (b->state == TAKT_UNACKNOWLEDGED && seen)
            b->state = TAKT_ACKNOWLEDGED;
        else if (b->state != TAKT_ACKNOWLEDGED)
            b->state = TAKT_UNACKNOWLEDGED;
    } else if ((b->state == TAKT_UNACKNOWLEDGED || b->state == TAKT_RETURNED_UNACKNOWLEDGED) && !seen) {
        b->state = TAKT_RETURNED_UNACKNOWLEDGED;
    } else {
        b->state = TAKT_NORMAL;
    }
    b->raw = raw;
    b->held = is_nan ? b->held : raw;
    b->last_acknowledge = acknowledge;
    return b->state;
}

/* ---- Fast Fourier transform ---- */

#define TAKT_FFT_STAGES 31

static inline void takt_fft_swap(double *values, size_t a, size_t b) {
    const double value = values[a];
    values[a] = values[b];
    values[b] = value;
}

/* Transforms length complex values in place. FALSE, and nothing changed, if length is no power of two from
 * 1 to 2^31. */
static inline bool takt_fft_transform(double *real, double *imaginary, size_t length) {
    double cos[TAKT_FFT_STAGES], sin[TAKT_FFT_STAGES]; /* exp(-pi i / 2^k) */
    size_t index, reversed = 0, half, turn, low, bit;
    unsigned k, stage;
    if (length == 0 || (length & (length - 1)) != 0 || length > (size_t)1 << TAKT_FFT_STAGES)
        return false;
    for (index = 1; index < length; index++) {
        for (bit = length / 2; (reversed & bit) != 0; bit /= 2)
            reversed ^= bit;
        reversed |= bit;
        if (index < reversed) {
            takt_fft_swap(real, index, reversed);
            takt_fft_swap(imaginary, index, reversed);
        }
    }
    cos[0] = -1.0;
    sin[0] = 0.0;
    cos[1] = 0.0;
    sin[1] = -1.0;
    for (k = 2; k < TAKT_FFT_STAGES; k++) {
        cos[k] = takt_square_root((1.0 + cos[k - 1]) / 2.0);
        sin[k] = sin[k - 1] / (2.0 * cos[k]);
    }
    for (stage = 0, half = 1; half < length; stage++, half *= 2) {
        for (turn = 0; turn < half; turn++) {
            double re = 1.0, im = 0.0;
            for (k = 0; k < stage; k++) {
                if ((turn >> k & 1) != 0) {
                    const double next = re * cos[stage - k] - im * sin[stage - k];
                    im = re * sin[stage - k] + im * cos[stage - k];
                    re = next;
                }
            }
            for (low = turn; low < length; low += 2 * half) {
                const size_t high = low + half;
                const double odd_re = real[high] * re - imaginary[high] * im;
                const double odd_im = real[high] * im + imaginary[high] * re;
                real[high] = real[low] - odd_re;
                imaginary[high] = imaginary[low] - odd_im;
                real[low] += odd_re;
                imaginary[low] += odd_im;
            }
        }
    }
    return true;
}

/* The inverse, with the factor 1 / length. */
static inline bool takt_fft_inverse(double *real, double *imaginary, size_t length) {
    size_t k;
    if (!takt_fft_transform(imaginary, real, length))
        return false;
    for (k = 0; k < length; k++) {
        real[k] /= (double)length;
        imaginary[k] /= (double)length;
    }
    return true;
}

#endif
