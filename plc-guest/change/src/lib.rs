//! How a running control program becomes another version of itself.
//!
//! A new version has its variables at other places, some with other types, some of them new. Between two
//! cycles each value has to get to where the new code looks for it. What is to be done is worked out
//! beforehand, from the tables of both images ([`make`]), and is one small table of bytes: a [`Plan`].
//! The kernel carries it out ([`Ready::apply`]) while no task of the program has a job.
//!
//! The two halves distrust each other. A plan is checked as a whole before a byte of the state is touched
//! ([`Plan::parse`]): each range is inside, no byte is written twice, each conversion is a legal one, and the time that
//! it takes is bounded by [`cost::COMMIT_NS`]. So a plan that lies can at worst give a program wrong values, never
//! damage its neighbours or take their time.
//!
//! | module | what it does |
//! | --- | --- |
//! | [`plan`] | the plan as bytes, and its rules |
//! | [`conversion`] | which types widen to which, and how a value does |
//! | [`apply`] | carries a plan out |
//! | [`cost`] | the time that it takes |
//! | [`large`] | a plan for more than fits between two cycles, and what carries it out |
//! | [`make`] (feature `make`) | from two images to a plan, with what engineers are told |

#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "make")]
extern crate std;

pub mod apply;
pub mod conversion;
pub mod cost;
mod header;
pub mod large;
#[cfg(feature = "make")]
pub mod make;
pub mod plan;

pub use apply::{Memory, Ready, Room};
pub use conversion::Conversion;
pub use cost::Cost;
pub use header::is_to_second;
pub use large::{LargePlan, TwoStates};
pub use plan::{Defect, Plan, Step};
