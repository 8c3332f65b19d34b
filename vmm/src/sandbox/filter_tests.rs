//! Tests of the filters, in threads of their own: a filter holds for the rest of a thread's life.

use std::io;
use std::thread;

use super::*;
use crate::sandbox::privileges;

const KINDS: [Kind; 12] = [
    Kind::Plc,
    Kind::Linux,
    Kind::WindowEnforcer,
    Kind::Loader,
    Kind::PlcLoader,
    Kind::Disk,
    Kind::Writer,
    Kind::Saver,
    Kind::Reader,
    Kind::Closer,
    Kind::Main,
    Kind::Guardian,
];

/// What a program says of a call: the few instructions that the filters are made of, interpreted.
fn verdict(kind: Kind, mode: Mode, call: libc::c_long, arguments: [u64; 6]) -> u32 {
    let program = instructions(kind.program(), mode);
    let data = |offset: u32| match offset {
        0 => call as u32,
        // AUDIT_ARCH_X86_64
        4 => 0xc000_003e,
        // The arguments, of which each has two halves.
        _ => {
            let argument = arguments[(offset as usize - 16) / 8];
            (if offset.is_multiple_of(8) { argument } else { argument >> 32 }) as u32
        }
    };
    let (mut at, mut accumulator) = (0, 0);
    loop {
        let libc::sock_filter { code, jt, jf, k } = program[at];
        at += 1;
        let holds = match code {
            0x20 => {
                accumulator = data(k);
                continue;
            }
            0x54 => {
                accumulator &= k;
                continue;
            }
            0x05 => {
                at += k as usize;
                continue;
            }
            0x06 => return k,
            0x15 => accumulator == k,
            0x25 => accumulator > k,
            0x35 => accumulator >= k,
            _ => panic!("{kind:?}: instruction {code:#x}"),
        };
        at += usize::from(if holds { jt } else { jf });
    }
}

fn allows(kind: Kind, call: libc::c_long, arguments: [u64; 6]) -> bool {
    match verdict(kind, Mode::Enforce, call, arguments) {
        libc::SECCOMP_RET_ALLOW => true,
        libc::SECCOMP_RET_TRAP => false,
        other => panic!("{kind:?}: call {call} is answered with {other:#x}"),
    }
}

#[test]
fn each_kind_may_do_its_own() {
    let ioctl = |request| [3, request, 0, 0, 0, 0];
    const KVM_RUN: u64 = 0xae80;
    const KVM_CREATE_VM: u64 = 0xae01;
    for kind in KINDS {
        let runs = matches!(kind, Kind::Plc | Kind::Linux | Kind::Loader);
        assert_eq!(allows(kind, libc::SYS_ioctl, ioctl(KVM_RUN)), runs, "{kind:?}");
        let makes = kind == Kind::Loader;
        assert_eq!(allows(kind, libc::SYS_ioctl, ioctl(KVM_CREATE_VM)), makes, "{kind:?}");
        // Not the request, but something that looks like it in the wrong place.
        assert!(!allows(kind, libc::SYS_ioctl, [KVM_RUN, 0, KVM_RUN, 0, 0, 0]), "{kind:?}");
        let opens = kind == Kind::Main;
        assert_eq!(allows(kind, libc::SYS_openat, [0; 6]), opens, "{kind:?}");
        assert!(allows(kind, libc::SYS_exit_group, [0; 6]), "{kind:?}");
    }
}

#[test]
fn no_thread_may_start_anything_or_take_privileges() {
    let calls = [
        libc::SYS_execve,
        libc::SYS_execveat,
        libc::SYS_clone,
        libc::SYS_clone3,
        libc::SYS_fork,
        libc::SYS_ptrace,
        libc::SYS_socket,
        libc::SYS_connect,
        libc::SYS_iopl,
        libc::SYS_capset,
        libc::SYS_sched_setattr,
        libc::SYS_mount,
        libc::SYS_bpf,
        libc::SYS_prctl,
        libc::SYS_rt_sigaction,
        libc::SYS_io_uring_setup,
        libc::SYS_process_vm_writev,
        // Another ABI's numbers.
        0x4000_0000 | libc::SYS_write,
        -1,
    ];
    for kind in KINDS {
        for call in calls {
            assert!(!allows(kind, call, [0; 6]), "{kind:?} may make call {call}");
        }
    }
}

#[test]
fn only_the_guardian_takes_ports() {
    for kind in KINDS {
        let takes = allows(kind, libc::SYS_ioperm, [0x378, 3, 1, 0, 0, 0]);
        assert_eq!(takes, kind == Kind::Guardian, "{kind:?}");
    }
}

/// On a deadline thread it would give the rest of a window away, so nothing that these threads use may
/// make this call: see `crate::handoff`.
#[test]
fn no_thread_with_windows_gives_its_processor_away_nor_does_what_loads_its_guest() {
    for kind in
        [Kind::Plc, Kind::Linux, Kind::WindowEnforcer, Kind::Disk, Kind::Loader, Kind::PlcLoader]
    {
        assert!(!allows(kind, libc::SYS_sched_yield, [0; 6]), "{kind:?}");
    }
}

#[test]
fn a_plc_with_interrupts_may_be_started_anew() {
    const KVM_SET_LAPIC: u64 = 0x4400_ae8f;
    const KVM_SET_MP_STATE: u64 = 0x4004_ae99;
    for request in [KVM_SET_LAPIC, KVM_SET_MP_STATE] {
        assert!(allows(Kind::Plc, libc::SYS_ioctl, [3, request, 0, 0, 0, 0]), "{request:#x}");
    }
}

#[test]
fn no_memory_becomes_executable_and_no_signal_but_a_kick_is_sent() {
    const EXECUTABLE: u64 = 4;
    for kind in KINDS {
        let anonymous = |protection| [0, 4096, protection, 0x22, u64::MAX, 0];
        assert!(allows(kind, libc::SYS_mmap, anonymous(3)), "{kind:?}");
        assert!(!allows(kind, libc::SYS_mmap, anonymous(EXECUTABLE | 1)), "{kind:?}");
        assert!(!allows(kind, libc::SYS_mprotect, [0, 4096, EXECUTABLE, 0, 0, 0]), "{kind:?}");
        let file = [0, 4096, 3, 1, 7, 0];
        assert_eq!(allows(kind, libc::SYS_mmap, file), kind == Kind::Loader, "{kind:?}");
        assert!(allows(kind, libc::SYS_tgkill, [1, 1, 23, 0, 0, 0]), "{kind:?}");
        assert!(!allows(kind, libc::SYS_tgkill, [1, 1, 9, 0, 0, 0]), "{kind:?}");
    }
}

#[test]
fn what_a_plc_calls_in_each_cycle_is_compared_first() {
    let program = instructions(Kind::Plc.program(), Mode::Enforce);
    let compared = program.iter().filter(|i| i.code == 0x15).map(|i| i.k);
    let compared: Vec<u32> = compared.take(3).collect();
    // The architecture, the call, the request.
    assert_eq!(compared, [0xc000_003e, libc::SYS_ioctl as u32, 0xae80]);
}

#[test]
fn a_mode_that_only_logs_allows_everything_else() {
    assert_eq!(verdict(Kind::Plc, Mode::Log, libc::SYS_execve, [0; 6]), libc::SECCOMP_RET_LOG);
    assert_eq!(
        verdict(Kind::Plc, Mode::Log, libc::SYS_clock_nanosleep, [0; 6]),
        libc::SECCOMP_RET_ALLOW
    );
}

#[test]
fn the_kernel_takes_every_program() {
    for kind in KINDS {
        let installed = thread::spawn(move || -> io::Result<()> {
            privileges::no_new_privileges()?;
            install(kind, Mode::Log)
        });
        installed.join().unwrap().unwrap();
    }
}
