//! Tests of a program, which a runner executes one by one.
//!
//! A test is the body of a program of its own. All of a project are entered by one task more, the last, which looks at
//! a variable for the number of the test that is wanted.

use super::{Comparison, GlobalId, Location, TypeId};

/// All tests of a project.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tests {
    /// In the order of their files and lines.
    pub list: Vec<Test>,
    /// The variable, a LINT, with the number of the wanted test. Present if there is a test.
    pub wanted: Option<GlobalId>,
    /// What the tests assert.
    pub assertions: Vec<Assertion>,
}

/// `TEST 'name' ... END_TEST`
#[derive(Clone, Debug, PartialEq)]
pub struct Test {
    /// What the string says.
    pub name: String,
    /// Where it begins.
    pub location: Location,
}

/// `ASSERT(...)` or `ASSERT_NEAR(...)`
#[derive(Clone, Debug, PartialEq)]
pub struct Assertion {
    /// As it is written.
    pub text: String,
    /// What its author says of it.
    pub message: Option<String>,
    /// The two values that it compares.
    pub compared: Option<Compared>,
    /// Where it stands.
    pub location: Location,
}

/// The two sides of a comparison, as they were when it did not hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compared {
    /// The variable that keeps the left value.
    pub found: GlobalId,
    /// Its type.
    pub found_type: TypeId,
    /// The variable that keeps the right value.
    pub expected: GlobalId,
    /// Its type.
    pub expected_type: TypeId,
    /// What should hold between the two.
    pub comparison: Comparison,
    /// How far from each other they may be, of [`Comparison::Equal`].
    pub tolerance: Option<f64>,
}
