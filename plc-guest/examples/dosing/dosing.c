/* Doses batches: the rising edge of a button orders one, and the valve is open until its amount has flowed.
 *
 * An event task takes the orders, and a queue carries them to the cyclic task, which alone has the valve. */
#include "takt.h"
#include "blocks.h"

TAKT_PROGRAM("dosing", 0, 1, 0, 0);

TAKT_INPUT(REAL, flow, 0);        /* %ID0, in litres per second */
TAKT_INPUT(REAL, amount, 4);      /* %ID1, in litres: of the batch that is ordered next */
TAKT_INPUT_BIT(button, 8, 0);     /* %IX8.0 */
TAKT_OUTPUT(REAL, dosed, 0);      /* %QD0, in litres: of the current batch, or the last */
TAKT_OUTPUT(UINT, batches, 4);    /* %QW2: complete ones */
TAKT_OUTPUT_BIT(valve, 6, 0);     /* %QX6.0 */
TAKT_OUTPUT_BIT(gave_up, 6, 1);   /* %QX6.1: the last batch took too long, or its flow is unknown */
TAKT_OUTPUT_BIT(refused, 7, 0);   /* %QX7.0: the last order was no amount, or too many were waiting */

/* Amounts that are ordered and not begun. */
TAKT_QUEUE(orders, sizeof(float), 4);

static void order(const takt_job *job) {
    (void)job;
    float wanted = amount;
    /* Not a number is no amount either. */
    refused(!(wanted > 0) || takt_send(orders, &wanted, sizeof wanted) != 0);
}
TAKT_EVENT(order, "rise:button", .period = TAKT_MS(20), .priority = 0, .budget = TAKT_US(100));
TAKT_WRITES(order, refused);

/* The longest time that a batch may take: without flow the valve would stay open. */
#define BATCH_NS TAKT_MS(60000)

static float wanted; /* 0: no batch is running */
static struct takt_ton slow;

/* The time since this was called last. period_ns is that since the release before: a job that is skipped, as one over its
 * budget is, would take what flowed in it away. */
static uint64_t since_last(const takt_job *job) {
    static uint64_t last_ns;
    static bool has_last;
    uint64_t elapsed = has_last ? job->now_ns - last_ns : job->period_ns;
    last_ns = job->now_ns;
    has_last = true;
    return elapsed;
}

static void dose(const takt_job *job) {
    uint64_t elapsed = since_last(job);
    if (wanted > 0) {
        dosed += flow * (float)elapsed * 1e-9f;
        bool late = takt_ton_update(&slow, true, BATCH_NS, elapsed);
        bool done = dosed >= wanted;
        /* A flow that is not a number ends the batch, too: what has flowed is not known then. */
        if (!(dosed < wanted) || late) {
            wanted = 0;
            batches = (uint16_t)(batches + done);
            gave_up(!done);
            takt_log(done ? "a batch is complete" : "a batch is given up");
        }
    } else {
        takt_ton_update(&slow, false, BATCH_NS, elapsed);
        if (takt_receive(orders, &wanted, sizeof wanted, 0) == sizeof wanted)
            dosed = 0;
    }
    valve(wanted > 0);
}
TAKT_CYCLIC(dose, .period = TAKT_MS(10), .priority = 1, .budget = TAKT_US(200));
TAKT_WRITES(dose, dosed);
TAKT_WRITES(dose, batches);
TAKT_WRITES(dose, valve);
TAKT_WRITES(dose, gave_up);
