/*
 * Counts the instructions of the third call of a job: `count IMAGE.plc` of the only task of a program image,
 * `count LIBRARY.so FUNCTION` of a function in C. Both run in a child that is stepped with ptrace, between two breakpoints.
 *
 * The image is taken to be good: it comes from the compiler that is measured. docs/program-image.md has its format.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/ptrace.h>
#include <sys/user.h>
#include <sys/wait.h>
#include <unistd.h>

enum { TASKS = 7, CODE = 12, CONSTANTS = 13, STATE = 14 };
enum { SECTION_BYTES = 32, ENTRY_OF_A_TASK = 48, BREAKPOINT = 0xcc };

static const uint64_t code_at = 0x40000000, state_at = 0x50000000, information = 0x6ffff000;

typedef void (*job)(uint64_t);

static void fail(const char *what)
{
    fprintf(stderr, "count: %s\n", what);
    exit(2);
}

static void map(uint64_t at, size_t bytes)
{
    int rights = PROT_READ | PROT_WRITE | PROT_EXEC;
    int flags = MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED_NOREPLACE;
    if (mmap((void *)at, bytes, rights, flags, -1, 0) != (void *)at) fail("an address is taken");
}

static job load(const char *path)
{
    FILE *file = fopen(path, "rb");
    if (!file || fseek(file, 0, SEEK_END)) fail("cannot read the image");
    long bytes = ftell(file);
    unsigned char *image = malloc(bytes);
    rewind(file);
    if (!image || fread(image, 1, bytes, file) != (size_t)bytes) fail("cannot read the image");
    fclose(file);
    map(code_at, 32 << 20);
    map(state_at, 64 << 20);
    map(0x68000000, 1 << 16);
    map(0x68100000, 1 << 16);
    map(0x68200000, 1 << 16);
    map(information, 4096);
    uint32_t sections = *(uint32_t *)(image + 76), init = *(uint32_t *)(image + 88), entry = 0;
    unsigned char *table = image + *(uint64_t *)(image + 80);
    uint64_t code_bytes = 0;
    for (uint32_t index = 0; index < sections; index++) {
        unsigned char *section = table + SECTION_BYTES * index;
        unsigned char *content = image + *(uint64_t *)(section + 8);
        uint64_t size = *(uint64_t *)(section + 16);
        switch (*(uint32_t *)section) {
        case CODE:
            memcpy((void *)code_at, content, size);
            code_bytes = size;
            break;
        case CONSTANTS:
            memcpy((void *)(code_at + ((code_bytes + 4095) & ~4095ull)), content, size);
            break;
        case STATE:
            memcpy((void *)state_at, content, size);
            break;
        case TASKS:
            entry = *(uint32_t *)(content + ENTRY_OF_A_TASK);
            break;
        }
    }
    if (init != UINT32_MAX) ((job)(code_at + init))(information);
    return (job)(code_at + entry);
}

static void child(char **words)
{
    ptrace(PTRACE_TRACEME, 0, 0, 0);
    job entry;
    if (words[2]) {
        void *library = dlopen(words[1], RTLD_NOW);
        entry = library ? (job)dlsym(library, words[2]) : NULL;
        if (!entry) fail(dlerror());
    } else {
        entry = load(words[1]);
    }
    entry(information);
    entry(information);
    __asm__ volatile("int3");
    entry(information);
    __asm__ volatile("int3");
    _exit(0);
}

int main(int count, char **words)
{
    if (count != 2 && count != 3) fail("count IMAGE.plc, or count LIBRARY.so FUNCTION");
    pid_t pid = fork();
    if (pid == 0) child(words);
    int status;
    waitpid(pid, &status, 0);
    if (!WIFSTOPPED(status) || WSTOPSIG(status) != SIGTRAP) fail("it ended before it was counted");
    for (unsigned long steps = 1;; steps++) {
        struct user_regs_struct registers;
        ptrace(PTRACE_SINGLESTEP, pid, 0, 0);
        waitpid(pid, &status, 0);
        if (!WIFSTOPPED(status) || WSTOPSIG(status) != SIGTRAP) fail("it ended while it was counted");
        ptrace(PTRACE_GETREGS, pid, 0, &registers);
        if ((ptrace(PTRACE_PEEKTEXT, pid, registers.rip, 0) & 0xff) == BREAKPOINT) {
            printf("%lu\n", steps);
            kill(pid, SIGKILL);
            return 0;
        }
    }
}
