//! The Structured Text compiler: IEC 61131-3:2013 source in, a program image of Takt out.
//!
//! The stages are separate and each can be looked at: [`syntax`] turns a file into tokens and a
//! syntax tree, [`check`] turns the trees of all files of a [`project`] into one typed tree, [`hir`],
//! and the back ends interpret or compile that. A stage never stops at the first mistake: it adds to a
//! list of [`diagnostic`]s and goes on with what it understood, so that one run shows all mistakes of a
//! project. The next stage starts only if the list has no error.
//!
//! Every source is hostile: what a file can make the compiler spend is bounded (see [`limits`]).

pub mod build;
pub mod check;
pub mod diagnostic;
pub mod files;
pub mod format;
pub mod hir;
pub mod layout;
pub mod library;
pub mod limits;
pub mod manifest;
pub mod native;
pub mod project;
pub mod query;
pub mod source;
pub mod stack;
pub mod syntax;
