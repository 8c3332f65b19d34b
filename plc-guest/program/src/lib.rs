//! What control programs, the PLC's kernel, Takt and the tools agree on.
//!
//! A control program is built by a tool, checked by Takt, run by the kernel of the PLC guest and
//! watched from outside. These are compiled apart, and each distrusts what it gets. What they must agree on
//! is written once, here: the addresses of a program ([`address`]), the page that tells a task about
//! its job ([`TaskInformation`]), the calls of the kernel ([`call`]), and the format of a program
//! image ([`Image`]). `docs/program-image.md` has the format byte by byte.
//!
//! Reading needs no allocator, so the kernel can use it. [`Image::parse`] checks everything before it
//! gives anything: all ranges, names, types and limits. [`Image::verify`] (feature `hash`) also
//! checks the hash and, with the feature `signature`, the signature. A program that takes an image from
//! outside calls `verify`; the kernel calls `parse` on what Takt has verified.
//!
//! The feature `build` has `build::Builder`, which makes images.

#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "build")]
extern crate alloc;

pub mod address;
pub mod call;
pub mod limit;

mod bytes;
mod check_types;
mod code;
mod elementary;
mod error;
#[cfg(feature = "hash")]
mod hash;
mod image;
mod layout;
mod name;
mod object;
mod parse;
mod port;
mod section;
#[cfg(feature = "signature")]
pub mod signature;
mod source;
mod task;
mod task_information;
mod type_name;
mod types;
mod units;
mod variable;

#[cfg(feature = "build")]
pub mod build;

pub use elementary::Elementary;
pub use error::{Defect, ImageError};
pub use image::{Image, Version};
pub use layout::{ABI_VERSION, FORMAT_VERSION, HEADER_BYTES, MAGIC};
pub use object::{Object, ObjectKind};
pub use port::{Direction, Port};
pub use section::SectionKind;
pub use source::{Line, Place, Trap, TrapKind};
pub use task::{EventSource, Task, TaskKind};
pub use task_information::{Start, TaskInformation};
pub use type_name::TypeName;
pub use types::{Enumerator, Field, Type, TypeKind};
pub use units::{CodeOffset, Nanoseconds, TaskId, TypeId};
pub use variable::{Area, Flags, Variable};
