//! Images of programs that do nothing.

use takt_program::build::{Builder, Task};
use takt_program::{CodeOffset, Nanoseconds, signature};

/// A private key, for tests.
pub const PRIVATE: [u8; 32] = [7; 32];

/// A program of this name with one task each ms, which may take 50 us.
pub fn builder(name: &str) -> Builder {
    let mut builder = Builder::new(name);
    builder.code = vec![0xc3];
    builder.state_bytes = 100;
    builder.task(task("main", 1_000_000, 50_000, 0));
    builder
}

/// A cyclic task: period and budget in ns, 0 for no budget, and the priority.
pub fn task(name: &str, period: u64, budget: u64, priority: u8) -> Task {
    let budget = (budget > 0).then_some(Nanoseconds(budget));
    Task { budget, priority, ..Task::cyclic(name, Nanoseconds(period), CodeOffset(0)) }
}

/// Its bytes.
pub fn image(name: &str) -> Vec<u8> {
    builder(name).build().unwrap()
}

/// The same, signed with [`PRIVATE`].
pub fn signed(name: &str) -> Vec<u8> {
    let mut image = image(name);
    signature::sign(&mut image, &PRIVATE).unwrap();
    image
}

/// A public key as in the file.
pub fn public(private: &[u8; 32]) -> String {
    signature::public(private).iter().map(|byte| format!("{byte:02x}")).collect()
}
