//! The half of the kernel that carries out: pages, registers, the host, and the programs' calls.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`kernel`] | the loop: what is due, who runs, what an error leads to |
//! | [`start`] | programs, tasks and objects from the host's table and the images |
//! | [`context`] | from ring 0 to ring 3 and back |
//! | [`calls`] | what programs ask for |
//! | [`events`] | what event tasks wait for |
//! | [`program`], [`space`], [`memory`] | a program's memory, its page tables, and the RAM |
//! | [`process`], [`io`] | process images, and what is mapped to inputs and outputs |
//! | [`ports`] | ends of channels |
//! | [`change`], [`preparing`], [`version`] | another version of a program takes its place |
//! | [`carrying`] | its values get to the state of another version, while it runs |
//! | [`live`] | orders from Takt while the PLC runs |
//! | [`faults`], [`figures`], [`lines`] | what is told of errors and figures, and how much programs may log |
//! | [`processor`] | control registers |

pub mod calls;
pub mod carrying;
pub mod change;
pub mod context;
pub mod events;
pub mod exchange;
pub mod faults;
pub mod figures;
pub mod idle;
pub mod io;
pub mod kernel;
pub mod lines;
pub mod live;
pub mod memory;
pub mod ports;
pub mod preparing;
pub mod process;
pub mod processor;
pub mod program;
pub mod retain;
pub mod space;
pub mod start;
pub mod version;

/// Most tasks of all programs together, with one for the start of each that has an initialisation.
pub const TASKS: usize = takt_kernel::scheduler::TASKS_MAX;
/// Most programs.
pub const PROGRAMS: usize = takt_abi::program::PROGRAMS_MAX;
/// Most objects of all programs together.
pub const OBJECTS: usize = takt_kernel::scheduler::OBJECTS_MAX;

/// What decides.
pub type Scheduler = takt_kernel::scheduler::Scheduler<TASKS, PROGRAMS, OBJECTS>;
