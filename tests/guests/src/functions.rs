//! From a list of functions in assembler to their names and their bytes. What they are is in [`code`](crate::code).

/// Names the functions: a variant of [`Entry`], its label, and its code.
macro_rules! functions {
    ($($(#[doc = $doc:literal])* $name:ident = $label:literal: [$($line:literal),* $(,)?])*) => {
        /// A function that a task can have.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Entry {
            $($(#[doc = $doc])* $name,)*
        }

        impl Entry {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$name),*];

            /// Where it is in the code.
            #[must_use]
            pub fn offset(self) -> CodeOffset {
                let all: [*const u8; Self::ALL.len()] = {
                    unsafe extern "C" {
                        $(#[link_name = $label] #[allow(non_upper_case_globals, reason = "a label")] static $name: u8;)*
                    }
                    [$(&raw const $name),*]
                };
                CodeOffset((all[self as usize] as usize - start() as usize) as u32)
            }
        }

        global_asm!(
            ".pushsection .rodata.takt_test_programs, \"a\"",
            ".globl takt_test_start",
            "takt_test_start:",
            $(
                concat!(".globl ", $label),
                concat!($label, ":"),
                // rbx: the words of the task, each 64 bytes from the beginning of the state on.
                "push rbx",
                "mov ebx, [rdi + 4]",
                // That of an initialisation is far beyond all tasks.
                "and ebx, 31",
                "shl ebx, 6",
                "add ebx, 0x50000000",
                "inc qword ptr [rbx + 8]",
                $($line,)*
                "pop rbx",
                "ret",
            )*
            ".globl takt_test_end",
            "takt_test_end:",
            ".popsection",
        );
    };
}
