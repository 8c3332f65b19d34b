// Stands for QEMU in the test of scripts/qemu/heal.c. It has the functions that the library looks into, with the machine code
// of Debian's builds, around the words of one processor. ODD is the number of what differs from those builds, 0 is nothing.
// It runs each of them and prints what became of the words.
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

// Places of fields, in bytes: from the start of CPUState, but HFLAGS2 from that of CPUX86State, which begins at ENV.
#define ENV 0x2b80
#define EXCEPTION_INDEX 0x1f0
#define INTERRUPT_REQUEST 0x1e8
#define HFLAGS2 0x5c

#define TEXT_OF(number) #number
#define TEXT(number) TEXT_OF(number)
#define FUNCTION(name) ".balign 64\n.globl " name "\n.type " name ", @function\n" name ":\n endbr64\n"
// The library looks at so much of a function.
#define END " ret\n .space 48\n"
#define SET_VIRTUAL_INTERRUPT " .byte 0x81, 0x8b\n .long " TEXT(INTERRUPT_REQUEST - ENV) ", 0x100\n"

#if ODD == 1
#define NO_ERROR_CODE " sub %ecx, %ecx\n"
#else
#define NO_ERROR_CODE " xor %ecx, %ecx\n"
#endif
#if ODD == 2
#define NO_VECTOR "0"
#else
#define NO_VECTOR "-1"
#endif
#if ODD == 3
#define ONE_MORE SET_VIRTUAL_INTERRUPT
#else
#define ONE_MORE
#endif
#if ODD == 4
#define CLEARED "~0x100"
#else
#define CLEARED "~0x80"
#endif
#if ODD == 6
#define OTHER_REGISTER " mov %rax, %r8\n .byte 0x41\n"
#else
#define OTHER_REGISTER
#endif

__asm__(".text\n"
        FUNCTION("do_interrupt_x86_hardirq")
        " mov %edx, %r9d\n .byte 0x48, 0x81, 0xef\n .long " TEXT(ENV) "\n xor %r8d, %r8d\n" NO_ERROR_CODE
        " xor %edx, %edx\n .byte 0xe9\n .long do_interrupt_all - . - 4\n" END
        FUNCTION("cpu_loop_exit_noexc")
        " .byte 0xc7, 0x87\n .long " TEXT(EXCEPTION_INDEX) ", " NO_VECTOR "\n" END
        FUNCTION("cpu_interrupt")
        " .byte 0x09, 0xb7\n .long " TEXT(INTERRUPT_REQUEST) "\n" END
        FUNCTION("vmrun")
        " push %rbx\n mov %rdi, %rbx\n" SET_VIRTUAL_INTERRUPT ONE_MORE " pop %rbx\n" END
        FUNCTION("cpu_clear_ignne")
        " lea processor + " TEXT(ENV) "(%rip), %rax\n" OTHER_REGISTER " .byte 0x81, 0xa0\n .long " TEXT(HFLAGS2) ", " CLEARED "\n" END
        FUNCTION("pause_instruction")
        " .byte 0xc7, 0x87\n .long " TEXT(EXCEPTION_INDEX) ", 0x10000\n" END);

void do_interrupt_x86_hardirq(char *env, int vector, int is_hw);
void vmrun(char *env);
void cpu_clear_ignne(void);
void pause_instruction(char *cpu);

char processor[ENV + 4096];
static bool is_locked;
static int locks;

static int32_t *word(int place) {
    return (int32_t *)(processor + place);
}

bool bql_locked(void) {
    return is_locked;
}

#if ODD != 5
void bql_lock_impl(const char *file, int line) {
    (void)file;
    (void)line;
    is_locked = true;
    locks++;
}
#endif

void bql_unlock(void) {
    is_locked = false;
}

__attribute__((used)) void do_interrupt_all(char *cpu, int vector, int is_int, int error_code, uint64_t next_eip, int is_hw) {
    *(int32_t *)(cpu + EXCEPTION_INDEX) = vector;
    printf("delivered %d by %d (%d, %d, %d)\n", vector, is_hw, is_int, error_code, (int)next_eip);
}

int main(void) {
    do_interrupt_x86_hardirq(processor + ENV, 0x20, 1);
    printf("left over %d\n", *word(EXCEPTION_INDEX));
    *word(INTERRUPT_REQUEST) = 2;
    vmrun(processor + ENV);
    printf("requests %x, %d locks, %s\n", *word(INTERRUPT_REQUEST), locks, is_locked ? "locked" : "unlocked");
    *word(ENV + HFLAGS2) = -1;
    cpu_clear_ignne();
    printf("flags %x\n", *word(ENV + HFLAGS2));
    pause_instruction(processor);
    printf("pause %d\n", *word(EXCEPTION_INDEX));
}
