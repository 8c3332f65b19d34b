//! Takt: a type-1-style partitioning hypervisor on KVM.
//!
//! One partition file describes a PLC guest and a Linux guest; this crate runs them side by side
//! on one machine, neither trusting the other. `docs/architecture.md` tells the whole story.

pub mod appliance;
pub mod boot;
pub mod check;
pub mod config;
pub mod cpuset;
pub mod init_watch;
pub mod machine;
pub mod memory;
pub mod probe;
pub mod report;
pub mod run;
pub mod statistics;
pub mod supervisor;
pub mod terminal;
pub mod vcpu;
