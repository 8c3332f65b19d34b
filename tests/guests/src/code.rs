//! The functions, in assembler.
//!
//! `rdi` points to the task's information, in which its number is at 4. Each function finds the words of
//! its task in `rbx`, which the prologue sets: parameter at 0, jobs at 8, results from 16 on.

use core::arch::global_asm;
use takt_program::CodeOffset;

unsafe extern "C" {
    static takt_test_start: u8;
    static takt_test_end: u8;
    static takt_test_divide: u8;
}

fn start() -> *const u8 {
    &raw const takt_test_start
}

/// All functions.
pub fn bytes() -> &'static [u8] {
    let bytes = (&raw const takt_test_end) as usize - start() as usize;
    // SAFETY: the bytes between the labels are this crate's constants.
    unsafe { core::slice::from_raw_parts(start(), bytes) }
}

/// Where a function has an instruction that is in the trap map.
#[must_use]
pub fn trap_of(entry: Entry) -> Option<CodeOffset> {
    let at = (&raw const takt_test_divide) as usize - start() as usize;
    (entry == Entry::Divide).then_some(CodeOffset(at as u32))
}

functions! {
    /// Returns at once.
    Nothing = "takt_test_nothing": []
    /// Two instructions as many times as the parameter says.
    Work = "takt_test_work": ["mov rcx, [rbx]", "2:", "dec rcx", "jnz 2b"]
    /// Publishes its count of jobs in two words far from each other, with the parameter's work in between; counts
    /// up a third word that may be forced, and leaves what it saw in it in a fourth.
    Publish = "takt_test_publish": [
        "inc qword ptr [rbx + 16]",
        "mov rax, [rbx + 16]",
        "mov [rbx + 24], rax",
        "mov rax, [rbx + 8]",
        "mov [0x50001000], rax",
        "mov rcx, [rbx]", "2:", "dec rcx", "jnz 2b",
        "mov [0x50002000], rax",
    ]
    /// Publishes its count of jobs in as many words of 4 bytes as the parameter says.
    Fill = "takt_test_fill": [
        "mov rax, [rbx + 8]",
        "mov rcx, [rbx]",
        "mov edi, 0x50001000",
        "rep stosd",
    ]
    /// Works without end.
    Endless = "takt_test_endless": ["2:", "jmp 2b"]
    /// Takes object 0, a semaphore, stops the program with code 81 if it does not get it, and works without end.
    EndlessHolder = "takt_test_endless_holder": [
        "mov eax, 3", "xor edi, edi", "xor esi, esi", "syscall",
        "test rax, rax", "2:", "jz 2b",
        "mov edi, 81", "mov eax, 14", "syscall",
    ]
    /// Waits for a flag of object 0 that does not come, 1 us each time, without end.
    EndlessWaiter = "takt_test_endless_waiter": [
        "2:", "mov eax, 10", "xor edi, edi", "mov esi, 1", "xor edx, edx", "mov r10d, 1000", "syscall", "jmp 2b",
    ]
    /// Keeps patterns in all registers for as many rounds as the parameter says, looks at them in each, and
    /// stops the program with code 77 when one has changed.
    Patterns = "takt_test_patterns": [
        "push rbp", "push r12", "push r13", "push r14", "push r15",
        "mov rcx, [rbx]",
        "mov [rbx + 16], rsp",
        "mov dword ptr [rbx + 24], 0x3f80",
        "ldmxcsr [rbx + 24]",
        // rbx and rsp have meanings of their own; rcx counts.
        ".set takt_n, 1",
        ".irp r, rax, rdx, rsi, rdi, rbp, r8, r9, r10, r11, r12, r13, r14, r15",
        "mov \\r, -(0x11111100 + takt_n)",
        ".set takt_n, takt_n + 1",
        ".endr",
        ".irp i, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15",
        "mov qword ptr [rbx + 32], -(0x22222200 + \\i)",
        "mov qword ptr [rbx + 40], -(0x33333300 + \\i)",
        "movups xmm\\i, [rbx + 32]",
        ".endr",
        "2:",
        ".set takt_n, 1",
        ".irp r, rax, rdx, rsi, rdi, rbp, r8, r9, r10, r11, r12, r13, r14, r15",
        "cmp \\r, -(0x11111100 + takt_n)",
        "jne 3f",
        ".set takt_n, takt_n + 1",
        ".endr",
        ".irp i, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15",
        "movups [rbx + 32], xmm\\i",
        "cmp qword ptr [rbx + 32], -(0x22222200 + \\i)",
        "jne 3f",
        "cmp qword ptr [rbx + 40], -(0x33333300 + \\i)",
        "jne 3f",
        ".endr",
        "cmp rsp, [rbx + 16]",
        "jne 3f",
        "stmxcsr [rbx + 32]",
        "cmp dword ptr [rbx + 32], 0x3f80",
        "jne 3f",
        "dec rcx",
        "jnz 2b",
        "pop r15", "pop r14", "pop r13", "pop r12", "pop rbp",
        "jmp 4f",
        "3:",
        "mov edi, 77",
        "mov eax, 14",
        "syscall",
        "4:",
    ]
    /// Destroys what others may have in registers.
    Destroy = "takt_test_destroy": [
        "push rbp", "push r12", "push r13", "push r14", "push r15",
        ".irp r, rax, rcx, rdx, rsi, rdi, rbp, r8, r9, r10, r11, r12, r13, r14, r15",
        "mov \\r, 0x7777777777777777",
        ".endr",
        ".irp i, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15",
        "pcmpeqd xmm\\i, xmm\\i",
        ".endr",
        "pop r15", "pop r14", "pop r13", "pop r12", "pop rbp",
    ]
    /// As `Destroy`, and works for a random time first, so that what it preempts next goes on at a random instant.
    DestroyAtRandom = "takt_test_destroy_at_random": [
        "push rbp", "push r12", "push r13", "push r14", "push r15",
        // Knuth's MMIX generator, of which the upper bits are the random ones.
        "mov rax, 6364136223846793005", "imul rax, [rbx + 16]",
        "mov rcx, 1442695040888963407", "add rax, rcx", "mov [rbx + 16], rax",
        "shr rax, 54", "inc eax",
        "2:", "dec eax", "jnz 2b",
        ".irp r, rax, rcx, rdx, rsi, rdi, rbp, r8, r9, r10, r11, r12, r13, r14, r15",
        "mov \\r, 0x7777777777777777",
        ".endr",
        ".irp i, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15",
        "pcmpeqd xmm\\i, xmm\\i",
        ".endr",
        "pop r15", "pop r14", "pop r13", "pop r12", "pop rbp",
    ]
    /// Reads address 0.
    Null = "takt_test_null": ["mov rax, [0]"]
    /// Writes into its code.
    WriteCode = "takt_test_write_code": ["mov byte ptr [0x40000000], 0"]
    /// Writes into its constants.
    WriteConstants = "takt_test_write_constants": [
        // The constants are on the page after the code.
        "mov byte ptr [0x40001000], 0"
    ]
    /// Writes the information of its tasks.
    WriteInformation = "takt_test_write_information": ["mov byte ptr [rdi], 0"]
    /// Writes the call page.
    WriteCallPage = "takt_test_write_call_page": ["mov byte ptr [0x3ffff000], 0"]
    /// Jumps into its state.
    JumpIntoData = "takt_test_jump_into_data": ["mov eax, 0x50000000", "jmp rax"]
    /// Jumps to an address that is none.
    JumpFar = "takt_test_jump_far": ["mov rax, 0x8000000000000000", "jmp rax"]
    /// Calls itself without end.
    Overflow = "takt_test_overflow": ["2:", "push rax", "jmp 2b"]
    /// A stack pointer that is no address, and a push.
    NoStack = "takt_test_no_stack": ["mov rsp, 0x8000000000000000", "push rax"]
    /// Halts.
    Halt = "takt_test_halt": ["hlt"]
    /// Closes interrupts.
    CloseInterrupts = "takt_test_close_interrupts": ["cli"]
    /// Writes a foreign port.
    Port = "takt_test_port": ["mov dx, 0x7a08", "xor eax, eax", "out dx, eax"]
    /// Reads a control register.
    ControlRegister = "takt_test_control_register": ["mov rax, cr3"]
    /// Writes a register of the model.
    ModelRegister = "takt_test_model_register": ["mov ecx, 0xc0000082", "wrmsr"]
    /// Loads a table of gates.
    Gates = "takt_test_gates": ["lidt [rbx]"]
    /// An instruction that is none.
    Invalid = "takt_test_invalid": ["ud2"]
    /// Divides by zero, at a place in the trap map.
    Divide = "takt_test_divides": [
        "xor ecx, ecx", "test ecx, ecx", "jnz 2f",
        ".globl takt_test_divide", "takt_test_divide:", "ud2", "2:",
    ]
    /// Divides by zero, and lets the processor find it.
    DivideInstruction = "takt_test_divide_instruction": ["xor ecx, ecx", "xor edx, edx", "div ecx"]
    /// An aligned access to an address that is not aligned.
    Misaligned = "takt_test_misaligned": ["movaps xmm0, [rbx + 1]"]
    /// Steps through its instructions.
    Step = "takt_test_step": ["pushfq", "or qword ptr [rsp], 0x100", "popfq", "nop", "nop"]
    /// Steps into a call of the kernel.
    StepIntoCall = "takt_test_step_into_call": [
        "mov eax, 1", "pushfq", "or qword ptr [rsp], 0x100", "popfq", "syscall", "nop"
    ]
    /// A breakpoint.
    Breakpoint = "takt_test_breakpoint": ["int3"]
    /// The interrupt that begins a window.
    FalseTick = "takt_test_false_tick": ["int 32"]
    /// The system call of other systems.
    OldCall = "takt_test_old_call": ["int 0x80"]
    /// Writes the base of FS.
    Base = "takt_test_base": ["wrfsbase rax"]
    /// Loads a segment that is not there.
    Segment = "takt_test_segment": ["mov eax, 0x18", "mov fs, ax"]
    /// Asks for the extended states.
    ExtendedState = "takt_test_extended_state": ["xor ecx, ecx", "xgetbv"]
    /// Sets the extended states.
    SetExtendedState = "takt_test_set_extended_state": ["xor ecx, ecx", "xsetbv"]
    /// Reads an address that is none.
    ReadFar = "takt_test_read_far": ["mov rax, 0x8000000000000000", "mov rax, [rax]"]
    /// Reads behind its state.
    ReadBehind = "takt_test_read_behind": ["mov rax, [0x50004000]"]
    /// Executes its stack.
    ExecuteStack = "takt_test_execute_stack": ["push 0x90", "jmp rsp"]
    /// Jumps into the kernel.
    ExecuteKernel = "takt_test_execute_kernel": ["mov eax, 0x100000", "jmp rax"]
    /// Opens interrupts.
    OpenInterrupts = "takt_test_open_interrupts": ["sti"]
    /// Reads a foreign port.
    ReadPortByte = "takt_test_read_port_byte": ["mov dx, 0x60", "in al, dx"]
    /// Writes a foreign port from memory.
    WriteString = "takt_test_write_string": ["mov rsi, rbx", "mov dx, 0x7a0c", "outsd"]
    /// Writes a debug register.
    DebugRegister = "takt_test_debug_register": ["mov rax, rbx", "mov dr0, rax"]
    /// Writes the register of the task priority.
    TaskPriority = "takt_test_task_priority": ["xor eax, eax", "mov cr8, rax"]
    /// Reads a performance counter.
    PerformanceCounter = "takt_test_performance_counter": ["xor ecx, ecx", "rdpmc"]
    /// Loads a table of segments.
    Segments = "takt_test_segments": ["lgdt [rbx]"]
    /// Loads a task register.
    TaskRegister = "takt_test_task_register": ["mov eax, 0x28", "ltr ax"]
    /// Takes a page out of the processor's memory of page tables.
    ForgetPage = "takt_test_forget_page": ["invlpg [rbx]"]
    /// Throws the caches away.
    ForgetCaches = "takt_test_forget_caches": ["wbinvd"]
    /// Allows the x87 unit.
    ClearTaskSwitched = "takt_test_clear_task_switched": ["clts"]
    /// Exchanges the bases of GS.
    SwapBase = "takt_test_swap_base": ["swapgs"]
    /// Returns from a call as the kernel could.
    ReturnFromCall = "takt_test_return_from_call": ["lea rcx, [rip + 2f]", "mov r11, 0x3002", "sysretq", "2:"]
    /// Returns from an interrupt to ring 0.
    ReturnToRing0 = "takt_test_return_to_ring_0": [
        "mov rax, rsp", "push 0x10", "push rax", "pushfq", "push 8", "lea rax, [rip + 2f]", "push rax", "iretq", "2:",
    ]
    /// Returns to a code segment of ring 0.
    FarReturn = "takt_test_far_return": ["push 8", "lea rax, [rip + 2f]", "push rax", "retfq", "2:"]
    /// Loads the kernel's data segment.
    KernelSegment = "takt_test_kernel_segment": ["mov eax, 0x10", "mov ds, ax"]
    /// Sets bits of the state of SSE that are reserved.
    ReservedState = "takt_test_reserved_state": ["mov dword ptr [rbx + 16], -1", "ldmxcsr [rbx + 16]"]
    /// The debug exception, without a debugger.
    DebugInstruction = "takt_test_debug_instruction": [".byte 0xf1"]
    /// The page fault, called by its number.
    FalsePageFault = "takt_test_false_page_fault": ["int 14"]
    /// Saves the extended states.
    SaveExtendedState = "takt_test_save_extended_state": ["xor eax, eax", "xor edx, edx", "xsave [0x50002000]"]
    /// Waits for a write to memory.
    Monitor = "takt_test_monitor": ["mov rax, rbx", "xor ecx, ecx", "xor edx, edx", "monitor"]
    /// Calls the hypervisor, as guests on Intel do. KVM would write the other maker's instruction in its place.
    CallHypervisor = "takt_test_call_hypervisor": ["vmcall"]
    /// Calls the hypervisor, as guests on AMD do: KVM refuses it to ring 3, without an exception.
    CallHypervisorOfAmd = "takt_test_call_hypervisor_of_amd": ["mov eax, 5", "vmmcall", "test rax, rax", "js 2f", "ud2", "2:"]
    /// Asks for alignment checks, and reads a word that is not aligned.
    AlignmentCheck = "takt_test_alignment_check": [
        "pushfq", "or qword ptr [rsp], 0x40000", "popfq", "mov rax, [rbx + 1]",
    ]
    /// An SSE exception that was unmasked: a division by zero.
    SseDivide = "takt_test_sse_divide": [
        "mov dword ptr [rbx + 16], 0x1d80", "ldmxcsr [rbx + 16]",
        "pcmpeqd xmm0, xmm0", "pslld xmm0, 25", "psrld xmm0, 2", "xorps xmm1, xmm1", "divss xmm0, xmm1",
    ]
    /// Uses a register that is not there.
    Avx = "takt_test_avx": ["vxorps ymm0, ymm0, ymm0"]
    /// An x87 exception that was unmasked.
    X87 = "takt_test_x87": [
        "fninit", "mov word ptr [rbx + 16], 0x37b", "fldcw [rbx + 16]", "fld1", "fldz", "fdivp", "fwait"
    ]
    /// Reads the kernel's memory.
    ReadKernel = "takt_test_read_kernel": ["mov rax, [0x100000]"]
    /// Reads all RAM where the kernel sees it.
    ReadRam = "takt_test_read_ram": ["mov rax, 0xffff800000200000", "mov rax, [rax]"]
    /// Writes the page that the guest shares with the host.
    WriteStatus = "takt_test_write_status": ["mov eax, 0xc0001000", "mov qword ptr [rax], 0"]
    /// Sets all flags that ring 3 can, nested task and direction among them, and makes calls with them.
    Flags = "takt_test_flags": [
        "push 0x244ed7", "popfq", "mov eax, 1", "syscall", "mov eax, 99", "syscall",
        "cmp rax, -1", "jne 2f", "push 2", "popfq", "jmp 3f", "2:", "ud2", "3:",
    ]
    /// All calls with numbers, pointers and lengths that are none. Stops with code 78 at an answer that is no
    /// error.
    BadCalls = "takt_test_bad_calls": [
        "push r12", "push r13",
        // Objects that are not there, and pointers all over the place.
        "mov r12d, 2",
        "2:",
        "lea r13, [rip + 5f]",
        "3:",
        "mov eax, r12d",
        "mov rdi, -1",
        "mov rsi, [r13]",
        "mov rdx, 16",
        "mov r10, 1000",
        "mov r8, -1",
        "cmp eax, 2",
        "jne 4f",
        // A line of text has its pointer first.
        "mov rdi, rsi",
        "mov rsi, 16",
        "4:",
        "syscall",
        "test rax, rax",
        "jns 7f",
        "add r13, 8",
        "cmp qword ptr [r13], 1",
        "jne 3b",
        "inc r12d",
        "cmp r12d, 14",
        "jne 2b",
        // Numbers that are none.
        ".irp n, 15, 255, 0x7fffffff, -1, -2",
        "mov rax, \\n",
        "syscall",
        "cmp rax, -1",
        "jne 7f",
        ".endr",
        "jmp 6f",
        ".balign 8",
        "5:",
        ".quad 0, 0x1000, 0x100000, 0x3ffffff8, 0x4fffffff, 0x50003ff8, 0x5ffffff0, 0x5fffffff",
        ".quad 0xc0000000, 0xc0001000, 0x7fffffffffff, 0x800000000000, 0xffff800000200000",
        ".quad 0xfffffffffffffff0, 0xffffffffffffffff, 1",
        "7:",
        "mov edi, 78",
        "mov eax, 14",
        "syscall",
        "6:",
        "pop r13", "pop r12",
    ]
    /// Makes as many calls as the parameter says, with random numbers, objects, pointers, lengths and times, of which
    /// some are valid. It neither ends its job nor stops its program by one.
    RandomCalls = "takt_test_random_calls": [
        "push r12", "push r13",
        "mov r12, [rbx]",
        // Each task has a sequence of its own.
        "mov r13, [rbx + 16]", "add r13, rbx",
        "2:",
        ".irp r, rdi, rsi, rdx, r10",
        "mov rax, 6364136223846793005", "imul r13, rax", "mov rax, 1442695040888963407", "add r13, rax",
        "mov rcx, r13", "shr rcx, 33",
        "mov rax, r13", "shr rax, 61",
        "cmp eax, 3", "jb 3f", "je 4f", "cmp eax, 6", "jb 5f",
        // Anything;
        "mov \\r, r13", "jmp 6f",
        // or a small number, as those of objects and lengths are;
        "3:", "and ecx, 31", "mov \\r, rcx", "jmp 6f",
        // or a pointer at the edge of something;
        "4:", "and ecx, 15", "lea rax, [rip + 7f]", "mov \\r, [rax + 8 * rcx]", "jmp 6f",
        // or one into the upper half of the state, where the calls may write.
        "5:", "and ecx, 0x1ff8", "add ecx, 0x50002000", "mov \\r, rcx",
        "6:",
        ".endr",
        "mov eax, r13d", "shr eax, 28",
        // END and STOP become numbers that are none.
        "test eax, eax", "jnz 3f", "mov eax, 15",
        "3:", "cmp eax, 14", "jne 3f", "mov rax, r13",
        "or eax, 64",
        "3:",
        "syscall",
        "dec r12", "jnz 2b",
        "mov [rbx + 16], r13",
        "jmp 3f",
        ".balign 8",
        "7:",
        ".quad 0, 0x1000, 0x100000, 0x3ffffff8, 0x40000000, 0x4fffffff, 0x50003ff8, 0x50003fff",
        ".quad 0x5ffffff0, 0x600ff000, 0x68000000, 0x6fffff00, 0xc0000000, 0x800000000000",
        ".quad 0xffff800000200000, 0xfffffffffffffff0",
        "3:",
        "pop r13", "pop r12",
    ]
    /// Stops the program with code 5.
    Stop = "takt_test_stop": ["mov edi, 5", "mov eax, 14", "syscall"]
    /// Faults in the job with the number of the parameter.
    FaultLater = "takt_test_fault_later": [
        "mov rax, [rbx]", "cmp [rbx + 8], rax", "jb 2f", "ud2", "2:"
    ]
    /// Sends its count to object 0, a queue of 8 bytes.
    Send = "takt_test_send": [
        "mov eax, 5", "xor edi, edi", "lea rsi, [rbx + 8]", "mov edx, 8", "syscall",
        "test rax, rax", "jz 2f", "ud2", "2:",
    ]
    /// Receives from object 0 for as long as the parameter says, and stops with code 79 if what it
    /// gets is not what it got last and one more.
    Receive = "takt_test_receive": [
        "mov eax, 6", "xor edi, edi", "lea rsi, [rbx + 16]", "mov edx, 8", "mov r10, [rbx]", "syscall",
        "cmp rax, 8", "jne 2f",
        "mov rax, [rbx + 24]", "inc rax", "mov [rbx + 24], rax",
        "cmp rax, [rbx + 16]", "je 3f",
        "2:", "mov edi, 79", "mov eax, 14", "syscall",
        "3:",
    ]
    /// Takes object 1, a semaphore, adds to a number in two steps with work between, and gives it.
    Guarded = "takt_test_guarded": [
        "mov eax, 3", "mov edi, 1", "xor esi, esi", "syscall",
        "test rax, rax", "jnz 3f",
        "mov rdx, [0x50003000]",
        "mov rcx, [rbx]", "2:", "dec rcx", "jnz 2b",
        "inc rdx", "mov [0x50003000], rdx",
        "lock inc qword ptr [0x50003008]",
        "cmp rdx, [0x50003008]", "jne 3f",
        "mov eax, 4", "mov edi, 1", "syscall",
        "test rax, rax", "jz 4f",
        "3:", "mov edi, 80", "mov eax, 14", "syscall",
        "4:",
    ]
    /// Changes a bit at 0x3010 of the state.
    Toggle = "takt_test_toggle": ["xor byte ptr [0x50003010], 1"]
    /// Writes its count to port 0.
    WritePort = "takt_test_write_port": [
        "mov eax, 13", "xor edi, edi", "lea rsi, [rbx + 8]", "mov edx, 8", "syscall",
        "test rax, rax", "jz 2f", "ud2", "2:",
    ]
    /// Reads from port 0, and stops with code 81 if it is not what it got last and one more.
    ReadPort = "takt_test_read_port": [
        "mov eax, 12", "xor edi, edi", "lea rsi, [rbx + 16]", "mov edx, 8", "syscall",
        "cmp rax, 8", "jne 2f",
        "mov rax, [rbx + 24]", "inc rax", "mov [rbx + 24], rax",
        "cmp rax, [rbx + 16]", "je 3f",
        "2:", "mov edi, 81", "mov eax, 14", "syscall",
        "3:",
    ]
    /// Asks for the time as often as the parameter says.
    Times = "takt_test_times": [
        "push r12", "mov r12, [rbx]", "2:", "mov eax, 1", "syscall", "dec r12", "jnz 2b", "pop r12",
    ]
    /// Leaves the time at its end.
    Stamp = "takt_test_stamp": ["rdtsc", "mov [0x50003020], eax"]
    /// Keeps the longest time since the one that `Stamp` or `StampAndSet` has left, and stops the program with it as code in
    /// the job with the number of the parameter.
    SinceStamp = "takt_test_since_stamp": [
        "rdtsc", "sub eax, [0x50003020]",
        "cmp rax, [rbx + 16]", "jbe 3f", "mov [rbx + 16], rax", "3:",
        "mov rax, [rbx]", "cmp [rbx + 8], rax", "jb 4f",
        "mov rdi, [rbx + 16]", "mov eax, 14", "syscall", "4:",
    ]
    /// Leaves the time and sets a flag of object 0.
    StampAndSet = "takt_test_stamp_and_set": [
        "rdtsc", "mov [0x50003020], eax", "mov eax, 9", "xor edi, edi", "mov esi, 1", "syscall",
    ]
    /// As `SinceStamp`, when that flag has been set, for which it waits for 900 us. Clears it.
    AwaitStamp = "takt_test_await_stamp": [
        "mov eax, 10", "xor edi, edi", "mov esi, 1", "xor edx, edx", "mov r10d, 900000", "syscall",
        "cmp rax, 1", "jne 5f",
        "rdtsc", "sub eax, [0x50003020]",
        "cmp rax, [rbx + 16]", "jbe 3f", "mov [rbx + 16], rax", "3:",
        "mov eax, 11", "xor edi, edi", "mov esi, 1", "syscall",
        "mov rax, [rbx]", "cmp [rbx + 8], rax", "jb 4f",
        "mov rdi, [rbx + 16]", "mov eax, 14", "syscall",
        "5:", "ud2",
        "4:",
    ]
    /// Copies the first 16 bytes of its inputs to its outputs.
    CopyInputs = "takt_test_copy_inputs": [
        "movups xmm0, [0x68000000]", "movups [0x68100000], xmm0",
    ]
    /// Counts its jobs in the first word of its outputs. Stops with code 82 if that word has another count, or if
    /// the first word of the inputs is what it was in the job before.
    NewInput = "takt_test_new_input": [
        "mov rax, [0x68000000]", "cmp rax, [rbx + 16]", "je 2f", "mov [rbx + 16], rax",
        "inc qword ptr [0x68100000]",
        "mov rax, [0x68100000]", "cmp rax, [rbx + 8]", "je 3f",
        "2:", "mov edi, 82", "mov eax, 14", "syscall",
        "3:",
    ]
    /// Counts its jobs in the second word of its outputs, and looks at the first words of inputs and outputs as often
    /// as the parameter says. Stops with code 83 if one of the three changes.
    SameInput = "takt_test_same_input": [
        "inc qword ptr [0x68100008]",
        "mov rax, [0x68000000]", "mov rdx, [0x68100000]", "mov rcx, [rbx]",
        "2:",
        "cmp rax, [0x68000000]", "jne 3f",
        "cmp rdx, [0x68100000]", "jne 3f",
        "dec rcx", "jnz 2b",
        "mov rax, [0x68100008]", "cmp rax, [rbx + 8]", "je 4f",
        "3:", "mov edi, 83", "mov eax, 14", "syscall",
        "4:",
    ]
    /// Counts its jobs in the first word of its outputs, works as often as the parameter says, and counts in the
    /// second.
    TwoOutputs = "takt_test_two_outputs": [
        "inc qword ptr [0x68100000]",
        "mov rcx, [rbx]", "2:", "dec rcx", "jnz 2b",
        "inc qword ptr [0x68100008]",
    ]
    /// Stops with code 84 if the first two words of its inputs differ, or if the first has become less. Says "more" in
    /// the job in which it reaches the parameter.
    TwoInputs = "takt_test_two_inputs": [
        "mov rax, [0x68000000]",
        "cmp rax, [0x68000008]", "jne 2f",
        "mov rdx, [rbx + 16]", "mov [rbx + 16], rax",
        "cmp rax, rdx", "jb 2f",
        "cmp rax, [rbx]", "jb 3f", "cmp rdx, [rbx]", "jae 3f",
        "mov eax, 2", "mov rdi, rbx", "add rdi, 56", "mov dword ptr [rdi], 0x65726f6d",
        "mov esi, 4", "syscall", "jmp 3f",
        "2:", "mov edi, 84", "mov eax, 14", "syscall",
        "3:",
    ]
    /// Says "rose" when the first word of its inputs is not zero any more, and "fell" when it is zero again.
    RiseAndFall = "takt_test_rise_and_fall": [
        "mov rdx, [rbx + 16]", "mov rax, [0x68000000]", "mov [rbx + 16], rax",
        "test rax, rax", "setnz al", "test rdx, rdx", "setnz dl", "cmp al, dl", "je 3f",
        "mov rdi, rbx", "add rdi, 56", "mov dword ptr [rdi], 0x6c6c6566",
        "test al, al", "jz 2f", "mov dword ptr [rdi], 0x65736f72", "2:",
        "mov eax, 2", "mov esi, 4", "syscall",
        "3:",
    ]
    /// Writes 7 to the first two words of its outputs, and causes a fault in the job with the number of the parameter.
    FaultingOutputs = "takt_test_faulting_outputs": [
        "mov qword ptr [0x68100000], 7", "mov qword ptr [0x68100008], 7",
        "mov rax, [rbx]", "cmp [rbx + 8], rax", "jb 2f", "ud2", "2:",
    ]
    /// Half of the count of its jobs in output byte 0; in byte 1, by turns, 0x0c and 0x0d, which strobes a printer.
    Print = "takt_test_print": [
        "mov rax, [rbx + 8]", "dec rax", "mov rdx, rax", "shr rax, 1", "mov [0x68100000], al",
        "and edx, 1", "or edx, 12", "mov [0x68100001], dl",
    ]
    /// Writes into its inputs.
    WriteInput = "takt_test_write_input": ["mov byte ptr [0x68000000], 1"]
    /// Says hello.
    Log = "takt_test_log": [
        "mov eax, 2", "mov rdi, 0x50000038", "mov dword ptr [rdi], 0x6c6c6568",
        "mov byte ptr [rdi + 4], 0x6f", "mov esi, 5", "syscall",
    ]
    /// Says "hi", a line feed, U+0085, which is one too, and "you".
    LogTwoLines = "takt_test_log_two_lines": [
        "mov eax, 2", "mov rdi, 0x50000078", "mov dword ptr [rdi], 0xc20a6968",
        "mov dword ptr [rdi + 4], 0x756f7985", "mov esi, 8", "syscall",
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_function_is_inside_of_the_code_and_at_a_place_of_its_own() {
        let mut offsets: Vec<u32> = Entry::ALL.iter().map(|entry| entry.offset().0).collect();
        assert!(offsets.iter().all(|offset| (*offset as usize) < bytes().len()));
        offsets.dedup();
        assert_eq!(offsets.len(), Entry::ALL.len());
    }

    #[test]
    fn the_trap_is_an_illegal_instruction() {
        let at = trap_of(Entry::Divide).map_or(0, |at| at.0 as usize);
        assert_eq!(bytes()[at..at + 2], [0x0f, 0x0b]);
        assert_eq!(trap_of(Entry::Nothing), None);
    }
}
