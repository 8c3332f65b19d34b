//! The decisions of the PLC's kernel: which task runs, which waits, and what an error of one leads to.
//!
//! The kernel has two halves. This library is the one that decides. It knows no register, no page
//! and no clock: instants come as arguments, and what it returns is carried out by the other half,
//! the binary of this package. So all of it runs in tests on the host, and a search through every
//! state of small systems shows what a proof on paper would claim (`search_tests`).
//!
//! | module | what it decides |
//! | --- | --- |
//! | [`task`] | what a task is, and in which state |
//! | [`rank`] | who runs |
//! | [`scheduler`] | releases, limits, ends, programs that start and stop |
//! | [`objects`] | semaphores, queues, mailboxes and event flags |
//! | [`can`] | what is received and sent by CAN controllers, and when |
//! | [`process_image`] | what becomes of the bytes of inputs and outputs |
//! | [`watchdog`] | when a job has used too much time |
//! | [`watch`] | which bytes of programs are looked at, and how far that has got |
//! | [`forces`] | which values an operator keeps |
//! | [`statistics`] | what is counted for each task |
//! | [`time`] | instants and spans in nanoseconds, and the clock that they are read from |
//!
//! Everything has a fixed size: nothing is allocated, and a scheduler is plain data that can be
//! copied and compared.

#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

pub mod can;
#[cfg(test)]
mod can_tests;
pub mod forces;
pub mod objects;
pub mod process_image;
#[cfg(test)]
mod process_image_tests;
#[cfg(test)]
mod random_tests;
pub mod rank;
pub mod scheduler;
#[cfg(test)]
mod scheduler_tests;
#[cfg(test)]
mod search_tests;
pub mod statistics;
pub mod task;
pub mod time;
pub mod watch;
pub mod watchdog;
