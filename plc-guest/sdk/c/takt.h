/* Writes control programs for Takt in C (C99 or newer, with the __asm__ and attributes of gcc and clang).
 *
 * A program declares its tasks, points and kernel objects with the macros below, at file level. Object files
 * are made freestanding, see the Makefile of `takt plc new NAME --lang c`, and `takt plc build` makes a program
 * image of them. There is no C library, no allocation and no thread-local variable. takt.c has the memory functions that
 * compilers call by themselves. */
#ifndef TAKT_H
#define TAKT_H

/* The PLC's kernel keeps the registers of SSE for programs, and not those of AVX: their instructions fault there, although the
 * machine that compiles may have them. */
#ifdef __AVX__
#error "takt.h: this compiler makes instructions of AVX, which the PLC's kernel does not give to programs; compile with -mno-avx, and without -march=native"
#endif

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* What a task is told about its job. Times are in nanoseconds. */
typedef struct {
    uint32_t version;     /* 1 */
    uint32_t task;        /* number of the task; UINT32_MAX in init */
    uint64_t cycle;       /* jobs of this task that were released before this one */
    uint64_t now_ns;      /* scheduled release since the partition's start */
    uint64_t period_ns;   /* since this task's last release; 0 in its first job */
    uint32_t start;       /* 0 after a cold start, 1 after a warm one */
    uint32_t flags;       /* 0 */
    uint64_t reserved[3]; /* 0 */
} takt_job;

/* TAKT_MS(10), TAKT_MS(2.5): as nanoseconds, whole numbers exactly, others rounded. */
#define TAKT_US(n) TAKT_NS_(n, 1000)
#define TAKT_MS(n) TAKT_NS_(n, 1000000)
#define TAKT_NS_(n, unit)                                                                         \
    _Generic((n), float: TAKT_ROUNDED_(n, unit), double: TAKT_ROUNDED_(n, unit),                  \
             long double: TAKT_ROUNDED_(n, unit), default: (uint64_t)(n) * unit##u)
#define TAKT_ROUNDED_(n, unit) ((uint64_t)((double)(n) * unit + 0.5))

/* The elementary types of IEC 61131-3 that points can have. */
typedef bool takt_BOOL;
typedef int8_t takt_SINT;
typedef int16_t takt_INT;
typedef int32_t takt_DINT;
typedef int64_t takt_LINT;
typedef uint8_t takt_USINT;
typedef uint16_t takt_UINT;
typedef uint32_t takt_UDINT;
typedef uint64_t takt_ULINT;
typedef uint8_t takt_BYTE;
typedef uint16_t takt_WORD;
typedef uint32_t takt_DWORD;
typedef uint64_t takt_LWORD;
typedef float takt_REAL;
typedef double takt_LREAL;
typedef int64_t takt_TIME;
typedef int64_t takt_LTIME;

/* Flags of a point. */
#define TAKT_RETAIN 1u
#define TAKT_PERSISTENT 2u
#define TAKT_FORCEABLE 32u

#define TAKT_INPUT_BASE 0x68000000
#define TAKT_OUTPUT_BASE 0x68100000

/* A record that `takt plc build` reads from the section takt_declare. */
struct takt_declaration {
    uint32_t version, kind;
    const char *name;
    uint64_t name_bytes;
    const volatile void *address;
    const char *text;
    uint64_t text_bytes;
    union {
        uint64_t numbers[8];
        struct {
            /* period: of an event task, the least time between two releases.
             * priority: 0 is the most urgent. budget, deadline: 0 is none. stack: bytes, 0 is 16 KiB. */
            uint64_t period, offset, priority, budget, deadline, stack, sensitivity;
        } task;
    } more;
};

#define TAKT_DECLARE_(id, kind_, name_, address_, text_, ...)                                     \
    __attribute__((section("takt_declare"), used, aligned(8)))                                    \
    static const struct takt_declaration takt_declaration_##id = {                                \
        1, kind_, name_, sizeof(name_) - 1, address_, text_, sizeof(text_) - 1, { __VA_ARGS__ } }

/* TAKT_PROGRAM("tank", 1, 0, 0, 0): name, version, and a category of the user's choice. */
#define TAKT_PROGRAM(name, major, minor, patch, category)                                         \
    TAKT_DECLARE_(program_, 1, name, 0, "", .numbers = { major, minor, patch, category })

/* TAKT_INIT(function): void function(const takt_job *job) runs once for each start. */
#define TAKT_INIT(function)                                                                       \
    TAKT_DECLARE_(init_, 2, #function, (const volatile void *)function, "", .numbers = { 0 })

/* TAKT_CYCLIC(control, .period = TAKT_MS(10), .priority = 1): the function's name is the task's. */
#define TAKT_CYCLIC(function, ...)                                                                \
    TAKT_DECLARE_(task_##function, 3, #function, (const volatile void *)function, "",             \
                  .task = { __VA_ARGS__ })

/* TAKT_EVENT(order, "channel:orders", .period = TAKT_MS(1)); sources: channel:, doorbell:, interrupt:, rise:. */
#define TAKT_EVENT(function, source, ...)                                                         \
    TAKT_DECLARE_(task_##function, 4, #function, (const volatile void *)function, source,         \
                  .task = { __VA_ARGS__ })

/* TAKT_WRITES(control, valve): which task writes a point. Each output of a program with several tasks needs one,
 * so that no two tasks write the same. */
#define TAKT_WRITES(function, point)                                                              \
    TAKT_DECLARE_(writes_##point, 13, #function, 0, #point, .numbers = { 0 })

/* TAKT_FREEWHEELING(rest, .priority = 255) */
#define TAKT_FREEWHEELING(function, ...)                                                          \
    TAKT_DECLARE_(task_##function, 5, #function, (const volatile void *)function, "",             \
                  .task = { __VA_ARGS__ })

/* float setpoint = 2; TAKT_POINT(REAL, setpoint, TAKT_RETAIN | TAKT_FORCEABLE): a global variable, or an
 * array of one dimension, that is seen from outside. The variable has exactly the type takt_REAL. */
#define TAKT_IS_(type, variable) __builtin_types_compatible_p(__typeof__(variable), takt_##type)
#define TAKT_IS_ARRAY_(type, variable) __builtin_types_compatible_p(__typeof__(variable), takt_##type[])
#define TAKT_POINT(type, variable, flags)                                                         \
    _Static_assert(TAKT_IS_(type, variable) || TAKT_IS_ARRAY_(type, variable),                    \
                   "TAKT_POINT: the variable `" #variable "` is neither a takt_" #type            \
                   " nor an array of takt_" #type " with one dimension");                         \
    TAKT_DECLARE_(point_##variable, 6, #variable, &variable, #type,                               \
                  .numbers = { TAKT_IS_ARRAY_(type, variable)                                     \
                                   ? sizeof(variable) / sizeof(takt_##type) : 0, flags, 0 })

/* char state[17] = "idle"; TAKT_STRING(state, TAKT_FORCEABLE): a text of up to 16 characters that ends at a 0, as
 * STRING[16] does. What comes from outside may lack the 0. */
#define TAKT_STRING(variable, flags)                                                              \
    _Static_assert(__builtin_types_compatible_p(__typeof__(variable), char[]),                    \
                   "TAKT_STRING: the variable `" #variable "` is no array of char");              \
    TAKT_DECLARE_(point_##variable, 6, #variable, &variable, "STRING",                            \
                  .numbers = { 0, flags, 0, sizeof(variable) - 1 })

/* TAKT_INPUT(REAL, level, 4): the variable `level` at byte 4 of %I. Another file that uses it says
 * TAKT_LOCATED(const, REAL, level, takt_input, 4), which declares nothing to the tool. The linker knows where
 * takt_input, takt_output and takt_marker are. Hidden: position-independent code would else look them up in a table, which
 * has no entries for a symbol plus an offset. */
#define TAKT_LOCATED(qualifier, type, variable, base, byte)                                       \
    extern qualifier volatile takt_##type variable __attribute__((visibility("hidden")));         \
    __asm__(".set " #variable ", " #base " + " #byte "\n")
#define TAKT_LOCATED_(qualifier, type, variable, base, byte, flags)                               \
    TAKT_LOCATED(qualifier, type, variable, base, byte);                                          \
    TAKT_DECLARE_(point_##variable, 6, #variable, &variable, #type, .numbers = { 0, flags, 0 })
#define TAKT_INPUT(type, variable, byte)                                                          \
    TAKT_LOCATED_(const, type, variable, takt_input, byte, 4u | TAKT_FORCEABLE)
#define TAKT_OUTPUT(type, variable, byte)                                                         \
    TAKT_LOCATED_(, type, variable, takt_output, byte, 8u | TAKT_FORCEABLE)
#define TAKT_MARKER(type, variable, byte)                                                         \
    TAKT_LOCATED_(, type, variable, takt_marker, byte, TAKT_FORCEABLE)
/* TAKT_INPUT_STRING(order, 16, 8): `order`, an array of 17 char at byte 8 of %I, is STRING[16]. */
#define TAKT_LOCATED_STRING_(qualifier, variable, characters, base, byte, flags)                  \
    extern qualifier volatile char variable[(characters) + 1]                                     \
        __attribute__((visibility("hidden")));                                                    \
    __asm__(".set " #variable ", " #base " + " #byte "\n");                                       \
    TAKT_DECLARE_(point_##variable, 6, #variable, &variable, "STRING",                            \
                  .numbers = { 0, flags, 0, characters })
#define TAKT_INPUT_STRING(variable, characters, byte)                                             \
    TAKT_LOCATED_STRING_(const, variable, characters, takt_input, byte, 4u | TAKT_FORCEABLE)
#define TAKT_OUTPUT_STRING(variable, characters, byte)                                            \
    TAKT_LOCATED_STRING_(, variable, characters, takt_output, byte, 8u | TAKT_FORCEABLE)
#define TAKT_CHECK_BIT_(macro, name, byte, bit)                                                   \
    _Static_assert((byte) >= 0 && (byte) < 65536 && (bit) >= 0 && (bit) < 8,                      \
                   macro ": `" #name "` has no byte from 0 to 65535 and bit from 0 to 7")
/* TAKT_INPUT_BIT(start, 8, 0) is %IX8.0: read by start(). */
#define TAKT_INPUT_BIT(name, byte, bit)                                                           \
    TAKT_CHECK_BIT_("TAKT_INPUT_BIT", name, byte, bit);                                           \
    static inline bool name(void) {                                                               \
        return (*(const volatile uint8_t *)(TAKT_INPUT_BASE + (byte)) >> (bit)) & 1;              \
    }                                                                                             \
    TAKT_DECLARE_(point_##name, 6, #name, (const volatile void *)(TAKT_INPUT_BASE + (byte)),      \
                  "BOOL", .numbers = { 0, 4u | TAKT_FORCEABLE, (bit) + 1 })

/* TAKT_OUTPUT_BIT(pump, 4, 0) is %QX4.0: written by pump(true). A bit has one writer; those beside it may have others. */
#define TAKT_OUTPUT_BIT(name, byte, bit)                                                          \
    TAKT_CHECK_BIT_("TAKT_OUTPUT_BIT", name, byte, bit);                                          \
    static inline void name(bool value) {                                                         \
        volatile uint8_t *at = (volatile uint8_t *)(TAKT_OUTPUT_BASE + (byte));                   \
        *at = (uint8_t)((*at & ~(1u << (bit))) | ((unsigned)value << (bit)));                     \
    }                                                                                             \
    TAKT_DECLARE_(point_##name, 6, #name, (const volatile void *)(TAKT_OUTPUT_BASE + (byte)),     \
                  "BOOL", .numbers = { 0, 8u | TAKT_FORCEABLE, (bit) + 1 })

/* Kernel objects and channel ports. Each is a number for the calls below; the tool fills it in. Compilers take what is volatile
 * for state, and a change of the program keeps state: the section makes the number a constant of this version. */
#define TAKT_OBJECT_(kind, name, a, b)                                                            \
    __attribute__((section(".data.rel.ro.takt_number")))                                          \
    static const volatile uint32_t name = 0;                                                      \
    TAKT_DECLARE_(object_##name, kind, #name, &name, "", .numbers = { a, b })
/* The ceiling is the priority of the most urgent task that takes it. One that is more urgent than all cyclic and event tasks of the
 * program counts as the most urgent of these. A freewheeling task can take a semaphore only if it has a budget. */
#define TAKT_SEMAPHORE(name, ceiling) TAKT_OBJECT_(7, name, ceiling, 0)
#define TAKT_QUEUE(name, message_bytes, depth) TAKT_OBJECT_(8, name, message_bytes, depth)
#define TAKT_MAILBOX(name, bytes) TAKT_OBJECT_(9, name, bytes, 0)
#define TAKT_FLAGS(name) TAKT_OBJECT_(10, name, 0, 0)
#define TAKT_PORT_IN(name, message_bytes) TAKT_OBJECT_(11, name, message_bytes, 0)
#define TAKT_PORT_OUT(name, message_bytes) TAKT_OBJECT_(12, name, message_bytes, 0)

/* Why a call failed: its result is one of these. */
enum {
    TAKT_BAD_NUMBER = -1,
    TAKT_BAD_POINTER = -2,
    TAKT_BAD_ID = -3,
    TAKT_TIMED_OUT = -4,
    TAKT_FULL = -5,
    TAKT_EMPTY = -6,
    TAKT_TOO_LONG = -7,
    TAKT_NOT_ALLOWED = -8,
    TAKT_CEILING = -9
};

/* Makes a call of the kernel. */
__attribute__((always_inline)) static inline int64_t takt_call(uint64_t number, uint64_t a,
                                                               uint64_t b, uint64_t c, uint64_t d) {
    int64_t result = (int64_t)number;
    register uint64_t r10 __asm__("r10") = d;
    __asm__ volatile("syscall" : "+a"(result) : "D"(a), "S"(b), "d"(c), "r"(r10)
                     : "rcx", "r11", "memory");
    return result;
}

/* Nanoseconds since the partition's start, now. */
static inline int64_t takt_time(void) { return takt_call(1, 0, 0, 0, 0); }
/* Logs a line of at most 120 bytes. */
__attribute__((always_inline)) static inline void takt_log(const char *text) {
    uint64_t length = 0;
    while (length < 120 && text[length]) length++;
    takt_call(2, (uint64_t)text, length, 0, 0);
}
/* Logs a line with numbers: as printf does, but only with %d %u %x %lld %llu %llx %f %s %c and %%. Between % and the
 * letter a width of up to 60 may be given, with a 0 or - before it, and for %f the digits behind the point: %06.2f. There are
 * 6 without, and no more than 9. A %f of 1e18 and above is written with an exponent. What is none of these, and all
 * that comes behind it, is logged as it is written. The line is cut behind 120 bytes. */
__attribute__((format(printf, 1, 2))) void takt_logf(const char *format, ...);
/* Takes a semaphore; waits up to timeout nanoseconds. */
static inline int64_t takt_take(uint32_t semaphore, uint64_t timeout) {
    return takt_call(3, semaphore, timeout, 0, 0);
}
static inline int64_t takt_give(uint32_t semaphore) { return takt_call(4, semaphore, 0, 0, 0); }
/* Puts a message into a queue; never waits. */
static inline int64_t takt_send(uint32_t queue, const void *message, uint64_t bytes) {
    return takt_call(5, queue, (uint64_t)message, bytes, 0);
}
/* Takes the oldest message out of a queue; the result is its length. */
static inline int64_t takt_receive(uint32_t queue, void *buffer, uint64_t bytes, uint64_t timeout) {
    return takt_call(6, queue, (uint64_t)buffer, bytes, timeout);
}
static inline int64_t takt_mailbox_write(uint32_t mailbox, const void *value, uint64_t bytes) {
    return takt_call(7, mailbox, (uint64_t)value, bytes, 0);
}
/* The result is the length, plus 2^32 if the value is new to this task. */
static inline int64_t takt_mailbox_read(uint32_t mailbox, void *buffer, uint64_t bytes) {
    return takt_call(8, mailbox, (uint64_t)buffer, bytes, 0);
}
static inline int64_t takt_flags_set(uint32_t flags, uint32_t mask) {
    return takt_call(9, flags, mask, 0, 0);
}
/* Waits for any (all = 0) or all (all = 1) of the bits; the result is those that are set. */
static inline int64_t takt_flags_wait(uint32_t flags, uint32_t mask, int all, uint64_t timeout) {
    return takt_call(10, flags, mask, (uint64_t)all, timeout);
}
static inline int64_t takt_flags_clear(uint32_t flags, uint32_t mask) {
    return takt_call(11, flags, mask, 0, 0);
}
/* Reads a message from a channel; the result is its length. */
static inline int64_t takt_channel_read(uint32_t port, void *buffer, uint64_t bytes) {
    return takt_call(12, port, (uint64_t)buffer, bytes, 0);
}
static inline int64_t takt_channel_write(uint32_t port, const void *message, uint64_t bytes) {
    return takt_call(13, port, (uint64_t)message, bytes, 0);
}
/* Stops the program, with a code that is told in the log. */
__attribute__((noreturn, always_inline)) static inline void takt_stop(uint32_t code) {
    for (;;) takt_call(14, code, 0, 0, 0);
}
/* Logs why, and faults: the program is stopped as its health table says. The tool knows this label: a fault there is the
 * program's own decision, and its place the line of the call. The line is an operand so that compilers do not
 * join two calls in one. */
#define takt_fail(why)                                                                            \
    __extension__({                                                                               \
        takt_log(why);                                                                            \
        __asm__ volatile("takt_trap_user_%=: ud2" : : "i"(__LINE__));                             \
        __builtin_unreachable();                                                                  \
    })

#endif
