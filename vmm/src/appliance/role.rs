//! What this process is to the appliance: asked once, when the program starts, and then passed on.

use std::path::Path;

use super::{FIRST, MODULE_LIST, OUT};

/// What this process is to the appliance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Role {
    /// Nothing: this is another machine, or a container.
    #[default]
    Stranger,
    /// Process 1, which prepares the machine and waits.
    PidOne,
    /// The child of process 1, whose results are carried out of the machine.
    Run,
    /// A program that something else has started there, as `scripts/host` does.
    Other,
}

impl Role {
    /// Looks.
    #[must_use]
    pub fn of_this_process() -> Role {
        Role::of(
            std::process::id(),
            std::os::unix::process::parent_id(),
            Path::new(MODULE_LIST).exists(),
        )
    }

    const fn of(process: u32, parent: u32, is_appliance: bool) -> Role {
        match (is_appliance, process, parent) {
            (false, ..) => Role::Stranger,
            (true, FIRST, _) => Role::PidOne,
            (true, _, FIRST) => Role::Run,
            (true, ..) => Role::Other,
        }
    }

    /// Whether all of this machine is Takt's to arrange.
    #[must_use]
    pub const fn owns_machine(self) -> bool {
        !matches!(self, Role::Stranger)
    }

    /// The folder whose files are carried out of the machine, if there is one.
    #[must_use]
    pub fn results(self) -> Option<&'static Path> {
        matches!(self, Role::Run).then_some(Path::new(OUT))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_role_follows_from_process_parent_and_machine() {
        assert_eq!(Role::of(1, 0, false), Role::Stranger, "a container");
        assert_eq!(Role::of(70, 1, false), Role::Stranger, "a service of a host");
        assert_eq!(Role::of(1, 0, true), Role::PidOne);
        assert_eq!(Role::of(70, 1, true), Role::Run);
        assert_eq!(Role::of(71, 70, true), Role::Other);
    }

    #[test]
    fn only_the_run_of_the_appliance_has_results_to_carry_out() {
        for role in [Role::Stranger, Role::PidOne, Role::Other] {
            assert_eq!(role.results(), None);
        }
        assert!(Role::Run.results().is_some());
        assert_eq!(Role::of_this_process(), Role::Stranger, "tests run on a host");
    }
}
