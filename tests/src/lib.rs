//! Whole-system tests; see the integration tests beside this file.
