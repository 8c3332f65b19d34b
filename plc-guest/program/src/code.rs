//! Enumerations that are numbers in the image or in a register.

/// Declares an enumeration with its numbers, and `from_code` and `ALLOWED` for what reads them.
macro_rules! codes {
    (
        $(#[$meta:meta])*
        pub enum $name:ident: $repr:ident {
            $($(#[$value_meta:meta])* $value:ident = $code:literal,)+
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr($repr)]
        pub enum $name {
            $($(#[$value_meta])* $value = $code,)+
        }

        impl $name {
            /// All values, in the order of their numbers.
            pub const ALL: &'static [Self] = &[$(Self::$value),+];

            /// The value with this number.
            #[must_use]
            pub const fn from_code(code: $repr) -> Option<Self> {
                match code {
                    $($code => Some(Self::$value),)+
                    _ => None,
                }
            }

            /// The number.
            #[must_use]
            pub const fn code(self) -> $repr {
                self as $repr
            }
        }
    };
}

pub(crate) use codes;
