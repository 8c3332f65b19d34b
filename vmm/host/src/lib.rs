//! What `takt` and `takt-doctor` both have to know of a host.
//!
//! The doctor tells in advance what `takt run` will meet, so both must read the host in the same way.
//! It links no hypervisor: what only a machine can tell of KVM, `takt probe --json` finds out, in the
//! form that [`kvm`] has.

pub mod cpu_list;
pub mod huge_pages;
pub mod kvm;
pub mod mounts;
pub mod resctrl;
