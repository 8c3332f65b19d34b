//! Takt: a type-1-style partitioning hypervisor on KVM.
//!
//! One partition file describes a PLC guest and a Linux guest; this crate runs them side by side
//! on one machine, neither trusting the other. `docs/architecture.md` tells the whole story.

pub mod account;
pub mod apic_keys;
pub mod appliance;
pub mod attendance;
pub mod boot;
pub mod channels;
pub mod console_log;
pub mod control;
pub mod cpuid;
pub mod cpuset;
pub mod delay;
pub mod disk;
pub mod doorbell;
pub mod event;
pub mod footprint;
pub mod handoff;
pub mod health;
pub mod hooks;
pub mod host_clock;
pub mod host_ports;
pub mod host_watchdog;
pub mod huge_pages;
pub mod init_watch;
pub mod interrupts;
pub mod kernel_tree;
pub mod kernel_watch;
pub mod life;
pub mod linux_machine;
pub mod live;
pub mod machine;
pub mod memory;
pub mod net;
pub mod outlet;
pub mod passthrough;
pub mod pci;
pub mod power_button;
pub mod prepare;
pub mod probe;
pub mod registers;
pub mod resctrl;
pub mod restart;
pub mod run;
pub mod run_error;
pub mod sandbox;
pub mod saver;
pub mod schedule_requests;
pub mod screen;
pub mod steering;
pub mod supervisor;
pub mod terminal;
pub mod topology;
pub mod unix_socket;
pub mod vcpu;
pub mod vhost;
pub mod virtio;
pub mod vsock;

pub use takt_figures::{load, report, samples, statistics, trace};
pub use takt_plan as config;
pub use takt_plan::check;
