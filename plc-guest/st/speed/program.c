/*
 * The kernels of this folder in C as tasks of one program, so that they run where those in Structured Text do.
 */
#include "kernels.c"

#include "takt.h"

TAKT_PROGRAM("c", 1, 0, 0, 0);

#define TASK(kernel)                                                                              \
    static void run_##kernel(const takt_job *job)                                                 \
    {                                                                                             \
        (void)job;                                                                                \
        k_##kernel();                                                                             \
    }                                                                                             \
    TAKT_CYCLIC(run_##kernel, .period = TAKT_MS(10), .priority = 1)

TASK(pid);
TASK(filter);
TASK(matrix);
TASK(state_machine);
TASK(text);
TASK(crc);
