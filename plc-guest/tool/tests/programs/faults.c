/* Does what its input tells: one fault each. The tests name the lines of the faults. */
#include "takt.h"

TAKT_PROGRAM("faults", 1, 0, 0, 0);
TAKT_INPUT(DINT, what, 0);
TAKT_OUTPUT(DINT, refused, 0);

static volatile int zero, data[4] = { 0x90 };
static int *volatile null_pointer;

static int deep(int n) {
    volatile char room[4000];
    room[n & 7] = 1; /* stack */
    return zero == 0 ? deep(n + 1) + room[0] : n;
}

static void run(const takt_job *job) {
    (void)job;
    switch (what) {
    case 1:
        *null_pointer = 1; /* null */
        break;
    case 2:
        zero = 100 / zero; /* zero */
        break;
    case 3:
        for (;;) zero++; /* endless */
    case 4:
        ((void (*)(void))(uintptr_t)data)(); /* data */
        break;
    case 5:
        __asm__ volatile("int $0x80" : : "a"(1)); /* foreign */
        break;
    case 6:
        __asm__ volatile("cli"); /* privileged */
        break;
    case 7:
        zero = deep(0);
        break;
    case 8:
        takt_fail("no pressure");
    case 9:
        takt_stop(5);
    case 10:
        *(volatile int *)&what = 3; /* input */
        break;
    case 11:
        *(volatile int *)0x40000000 = 3; /* code */
        break;
    case 12:
        ((void (*)(void))0)(); /* nowhere */
        break;
    case 13:
        *(volatile int *)0x7fffffff0000 = 3; /* wild */
        break;
    case 14:
        __asm__ volatile("pushf; orl $0x100,(%rsp); popf; nop");
        break; /* single step */
    case 15:
        __builtin_trap(); /* illegal */
    case 16:
        /* The number of exit() on Linux is no call here. */
        if (takt_call(60, 0, 0, 0, 0) != TAKT_BAD_NUMBER) takt_fail("exit");
        refused++;
        break;
    }
}
TAKT_CYCLIC(run, .period = TAKT_MS(1));
