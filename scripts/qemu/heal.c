// Heals three faults of QEMU's emulation of SVM, in the running QEMU. It is preloaded (LD_PRELOAD) wherever
// scripts/common/nested.sh starts QEMU with emulation.
//
// 1. An interrupt is delivered twice. VMRUN delivers an interrupt that the hypervisor injects by
//    do_interrupt_x86_hardirq(), but leaves its vector in CPUState.exception_index. If QEMU leaves its
//    translated code for another reason before the guest's next exit, it finds the vector there and delivers
//    it again. Every other caller of that function sets exception_index to -1 afterwards. Here the function
//    does so itself, which is right for all of them. (docs/decisions/0005-no-paravirtual-eoi.md)
//
// 2. An interrupt is lost. VMRUN sets a bit of CPUState.interrupt_request without QEMU's lock, by an
//    instruction that reads, changes and writes. A bit that another thread sets at the same time is gone.
//    Here VMRUN takes the lock first. (docs/decisions/0012-qemu-takes-its-lock.md)
//
// 3. The first processor's global interrupt flag is set back to what it was. FXRSTOR and XRSTOR clear another flag in the
//    same word, always that of the first processor and so on another one's thread too, by an instruction that reads,
//    changes and writes. If STGI, or VMRUN's exit, changes the word at the same time, that is undone: interrupts stay out for
//    ever, or come in where none may. Here that instruction is an atomic one. (the same decision)
//
// It also makes PAUSE cheap. QEMU leaves its loop over translated code for each, so that another processor of the
// machine gets its turn; a machine with one has no other. Where a kernel waits by PAUSE, as Linux does for 100 ms to
// measure its APIC's timer, that took half of the machine's start. Here the next code follows at once. What the machine
// executes stays the same, instruction by instruction.
//
// Nothing is known of where the fields and functions lie: both are read from QEMU's own instructions, and each
// instruction that is replaced is compared byte by byte first. What is not recognised stays as it is. Debian's
// builds of QEMU 7.2 and 10.0 are recognised.
//
// With TAKT_HEAL_TELL=1 in the environment the process says what can be healed, one word for each, and
// ends before QEMU starts:   once | twice   kept | lost
#define _GNU_SOURCE
#include <dlfcn.h>
#include <link.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

// A field's place: bytes from the start of CPUState.
typedef int32_t offset;

// What the faults have to do with, as found in this QEMU.
static struct {
    offset env;               // CPUX86State, which follows CPUState
    offset exception_index;
    offset interrupt_request;
    void (*do_interrupt_all)(char *cpu, int vector, int is_int, int error_code, uint64_t next_eip, int is_hw);
    bool (*locked)(void);
    void (*lock)(const char *file, int line);
    void (*unlock)(void);
} qemu;

// An instruction's operand, which need not be aligned.
static int32_t operand(const uint8_t *at) {
    int32_t value;
    memcpy(&value, at, sizeof value);
    return value;
}

static const uint8_t *past_endbr64(const uint8_t *code) {
    return memcmp(code, "\xf3\x0f\x1e\xfa", 4) ? code : code + 4;
}

// Finds `bytes` in the first 48 bytes of a function that is at least so long.
static const uint8_t *within(const uint8_t *function, const char *bytes, size_t length) {
    return memmem(function, 48, bytes, length);
}

// Overwrites code of QEMU's, which nothing runs yet: this is called before main().
static bool overwrite(uint8_t *at, const void *bytes, size_t length) {
    uintptr_t page = (uintptr_t)at & -(uintptr_t)4096;
    size_t pages = (uintptr_t)at + length - page;
    if (mprotect((void *)page, pages, PROT_READ | PROT_WRITE)) return false;
    memcpy(at, bytes, length);
    return !mprotect((void *)page, pages, PROT_READ | PROT_EXEC);
}

// jmp *(%rip), followed by the address to go to.
enum { JUMP = 14 };
static void put_jump(uint8_t *at, void *to) {
    memcpy(at, "\xff\x25\x00\x00\x00\x00", 6);
    memcpy(at + 6, &to, sizeof to);
}

// Takes the place of do_interrupt_x86_hardirq().
static void deliver_once(char *env, int vector, int is_hw) {
    char *cpu = env - qemu.env;
    // Does not come back if the delivery itself raises an exception, which is then the one to deliver.
    qemu.do_interrupt_all(cpu, vector, 0, 0, 0, is_hw);
    *(int32_t *)(cpu + qemu.exception_index) = -1;
}

static bool heal_double_delivery(void) {
    uint8_t *deliver = dlsym(RTLD_DEFAULT, "do_interrupt_x86_hardirq");
    const uint8_t *index = dlsym(RTLD_DEFAULT, "cpu_loop_exit_noexc");
    if (!deliver || !index) return false;
    // mov %edx,%r9d; sub $ENV,%rdi; xor %r8d,%r8d; xor %ecx,%ecx; xor %edx,%edx; jmp do_interrupt_all
    const uint8_t *code = past_endbr64(deliver);
    if (memcmp(code, "\x41\x89\xd1\x48\x81\xef", 6) || memcmp(code + 10, "\x45\x31\xc0\x31\xc9\x31\xd2\xe9", 8))
        return false;
    // movl $-1,EXCEPTION_INDEX(%rdi)
    index = within(index, "\xc7\x87", 2);
    if (!index || operand(index + 6) != -1) return false;
    qemu.env = operand(code + 6);
    qemu.exception_index = operand(index + 2);
    const uint8_t *all = code + 22 + operand(code + 18);
    memcpy(&qemu.do_interrupt_all, &all, sizeof all);
    uint8_t jump[JUMP];
    put_jump(jump, deliver_once);
    return overwrite(deliver, jump, sizeof jump);
}

// CPU_INTERRUPT_VIRQ: a virtual interrupt is pending, of which the hypervisor wants to know when it can be taken.
enum { VIRTUAL_INTERRUPT = 0x100 };

// What VMRUN's instruction did, under the lock that those who change the word from elsewhere hold. Called by
// set_virtual_interrupt.
__attribute__((used)) static void set_locked(char *env) {
    bool lock = !qemu.locked();
    if (lock) qemu.lock(__FILE__, __LINE__);
    *(uint32_t *)(env - qemu.env + qemu.interrupt_request) |= VIRTUAL_INTERRUPT;
    if (lock) qemu.unlock();
}

// Called in the place of an instruction, with env in rbx: all registers that a call may change are kept.
void set_virtual_interrupt(void);
__asm__(".text\n"
        "set_virtual_interrupt:\n"
        "  push %rbp\n  mov %rsp, %rbp\n"
        "  push %rax\n  push %rcx\n  push %rdx\n  push %rsi\n  push %rdi\n"
        "  push %r8\n  push %r9\n  push %r10\n  push %r11\n"
        "  sub $512, %rsp\n  and $-16, %rsp\n  fxsave64 (%rsp)\n"
        "  mov %rbx, %rdi\n  call set_locked\n"
        "  fxrstor64 (%rsp)\n  lea -72(%rbp), %rsp\n"
        "  pop %r11\n  pop %r10\n  pop %r9\n  pop %r8\n"
        "  pop %rdi\n  pop %rsi\n  pop %rdx\n  pop %rcx\n  pop %rax\n"
        "  pop %rbp\n  ret\n");

// A call or jump reaches 2 GiB.
static bool in_reach(const uint8_t *from, const uint8_t *to) {
    intptr_t way = (intptr_t)to - (intptr_t)from;
    return way == (int32_t)way;
}

// A page that a call from `near` reaches: behind QEMU, where the first free one is.
static uint8_t *page_near(uint8_t *near) {
    const size_t step = 1 << 20;
    for (uint8_t *at = near + (64 << 20); in_reach(near, at + 4096); at += step) {
        uint8_t *page = mmap((void *)((uintptr_t)at & -(uintptr_t)4096), 4096, PROT_READ | PROT_WRITE,
                             MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED_NOREPLACE, -1, 0);
        if (page != MAP_FAILED) return page;
    }
    return NULL;
}

// The one place of an instruction in QEMU's code.
struct place {
    uint8_t instruction[10];
    uint8_t *at;
    int count;
};

static int search(struct dl_phdr_info *object, size_t size, void *into) {
    struct place *place = into;
    for (int n = 0; n < object->dlpi_phnum; n++) {
        const ElfW(Phdr) *segment = &object->dlpi_phdr[n];
        if (segment->p_type != PT_LOAD || !(segment->p_flags & PF_X)) continue;
        uint8_t *code = (uint8_t *)object->dlpi_addr + segment->p_vaddr, *end = code + segment->p_memsz;
        while ((code = memmem(code, end - code, place->instruction, sizeof place->instruction))) {
            place->at = code++;
            place->count++;
        }
    }
    (void)size;
    return 1; // The first object is the program itself.
}

static bool find_lock(void) {
    // QEMU 9.0 gave them other names.
    static const char *const names[][3] = {
        {"bql_locked", "bql_lock_impl", "bql_unlock"},
        {"qemu_mutex_iothread_locked", "qemu_mutex_lock_iothread_impl", "qemu_mutex_unlock_iothread"},
    };
    for (size_t n = 0; n < sizeof names / sizeof *names; n++) {
        void *found[3];
        for (int m = 0; m < 3; m++) found[m] = dlsym(RTLD_DEFAULT, names[n][m]);
        if (!found[0] || !found[1] || !found[2]) continue;
        memcpy(&qemu.locked, &found[0], sizeof(void *));
        memcpy(&qemu.lock, &found[1], sizeof(void *));
        memcpy(&qemu.unlock, &found[2], sizeof(void *));
        return true;
    }
    return false;
}

// Expects what heal_double_delivery has found.
static bool heal_lost_interrupt(void) {
    const uint8_t *request = dlsym(RTLD_DEFAULT, "cpu_interrupt");
    if (!request || !find_lock()) return false;
    // or %esi,INTERRUPT_REQUEST(%rdi)
    request = within(request, "\x09\xb7", 2);
    if (!request) return false;
    qemu.interrupt_request = operand(request + 2);
    // orl $VIRTUAL_INTERRUPT,(INTERRUPT_REQUEST - ENV)(%rbx), which only VMRUN does
    struct place vmrun = {.instruction = "\x81\x8b"};
    offset from_env = qemu.interrupt_request - qemu.env;
    int32_t bit = VIRTUAL_INTERRUPT;
    memcpy(vmrun.instruction + 2, &from_env, 4);
    memcpy(vmrun.instruction + 6, &bit, 4);
    dl_iterate_phdr(search, &vmrun);
    if (vmrun.count != 1) return false;
    uint8_t *page = page_near(vmrun.at);
    if (!page) return false;
    put_jump(page, set_virtual_interrupt);
    // call PAGE, and a nop of five bytes
    uint8_t call[10] = {0xe8, 0, 0, 0, 0, 0x0f, 0x1f, 0x44, 0, 0};
    int32_t way = page - (vmrun.at + 5);
    memcpy(call + 1, &way, 4);
    return !mprotect(page, 4096, PROT_READ | PROT_EXEC) && overwrite(vmrun.at, call, sizeof call);
}

// Expects nothing. HF2_IGNNE_MASK, the flag that is cleared, is a bit of the word's lowest byte.
static bool heal_undone_flags(void) {
    enum { IGNNE = 0x80 };
    const uint8_t *clear = dlsym(RTLD_DEFAULT, "cpu_clear_ignne");
    if (!clear) return false;
    // andl $~IGNNE,HFLAGS2(%rax)
    uint8_t *at = (uint8_t *)within(clear, "\x81\xa0", 2);
    if (!at || operand(at + 6) != ~IGNNE) return false;
    // With such a prefix (REX) the operand is another.
    if ((at[-1] & 0xf0) == 0x40) return false;
    // lock andb $~IGNNE,HFLAGS2(%rax), and a nop of two bytes
    uint8_t atomic[10] = {0xf0, 0x80, 0xa0, 0, 0, 0, 0, 0x7f, 0x66, 0x90};
    memcpy(atomic + 3, at + 2, 4);
    return overwrite(at, atomic, sizeof atomic);
}

// Why QEMU's loop over translated code ends (EXCP_INTERRUPT), or that it goes on.
enum { LEAVE_THE_LOOP = 0x10000, GO_ON = -1 };

// Expects what heal_double_delivery has found.
static void shorten_pause(void) {
    // movl $LEAVE_THE_LOOP,FIELD, which only PAUSE does: EXCEPTION_INDEX(%rdi) in QEMU 7.2,
    // (EXCEPTION_INDEX - ENV)(%rbx) in 10.0
    struct place forms[] = {{.instruction = "\xc7\x87"}, {.instruction = "\xc7\x83"}};
    offset fields[] = {qemu.exception_index, qemu.exception_index - qemu.env};
    for (size_t n = 0; n < sizeof forms / sizeof *forms; n++) {
        int32_t why = LEAVE_THE_LOOP;
        memcpy(forms[n].instruction + 2, &fields[n], 4);
        memcpy(forms[n].instruction + 6, &why, 4);
        dl_iterate_phdr(search, &forms[n]);
        why = GO_ON;
        if (forms[n].count == 1 && overwrite(forms[n].at + 6, &why, 4)) return;
    }
}

__attribute__((constructor)) static void heal(void) {
    // Scripts start QEMU by way of other programs.
    if (!dlsym(RTLD_DEFAULT, "cpu_interrupt")) return;
    bool once = heal_double_delivery();
    bool kept = once && heal_lost_interrupt() && heal_undone_flags();
    if (once) shorten_pause();
    if (getenv("TAKT_HEAL_TELL")) {
        printf("%s %s\n", once ? "once" : "twice", kept ? "kept" : "lost");
        fflush(stdout);
        _exit(0);
    }
}
