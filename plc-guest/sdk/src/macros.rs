//! The macros that declare what a program has.

/// Puts a record into the section that the tool reads.
#[doc(hidden)]
#[macro_export]
macro_rules! __declare {
    ($declaration:expr) => {
        const _: () = {
            #[used]
            #[unsafe(link_section = "takt_declare")]
            static DECLARATION: $crate::declaration::Declaration = $declaration;
        };
    };
}

/// Declares the program: name, version (three numbers) and, if it matters, a category.
#[macro_export]
macro_rules! program {
    ($name:literal, $major:expr, $minor:expr, $patch:expr $(, category = $category:expr)? $(,)?) => {
        $crate::__declare!(
            $crate::declaration::Declaration::new($crate::declaration::kind::PROGRAM, $name)
                .numbers([$major, $minor, $patch, 0 $(+ $category)?, 0, 0, 0, 0])
        );
    };
}

/// Declares the function that runs once for each start: `fn(&Job)`.
#[macro_export]
macro_rules! init {
    ($function:path) => {
        const _: () = {
            extern "C" fn entry(job: &'static $crate::Job) {
                $function(job)
            }
            $crate::__declare!(
                $crate::declaration::Declaration::new($crate::declaration::kind::INIT, "init")
                    .at(entry as extern "C" fn(&'static $crate::Job) as *const ())
            );
        };
    };
}

/// Declares a task: name, function (`fn(&Job)`), and when it runs: [`Cyclic`](crate::Cyclic),
/// [`Event`](crate::Event) or [`Freewheeling`](crate::Freewheeling).
#[macro_export]
macro_rules! task {
    ($name:literal, $function:path, $when:expr) => {
        const _: () = {
            extern "C" fn entry(job: &'static $crate::Job) {
                $function(job)
            }
            const SCHEDULE: $crate::Schedule = $when.schedule();
            $crate::__declare!(
                $crate::declaration::Declaration::new(SCHEDULE.kind, $name)
                    .at(entry as extern "C" fn(&'static $crate::Job) as *const ())
                    .text(SCHEDULE.source)
                    .numbers(SCHEDULE.numbers)
            );
        };
    };
}

#[doc(hidden)]
#[macro_export]
macro_rules! __variable {
    ($name:literal, $address:expr, $ty:ty, $flags:expr, $bit:expr) => {
        $crate::__declare!(
            $crate::declaration::Declaration::new($crate::declaration::kind::VARIABLE, $name)
                .at($address as *const ())
                .text(<$ty as $crate::Value>::KEYWORD)
                .numbers([
                    <$ty as $crate::Value>::ELEMENTS,
                    $flags,
                    $bit,
                    <$ty as $crate::Value>::CHARACTERS,
                    0,
                    0,
                    0,
                    0,
                ])
        );
    };
}

/// Declares a value at a byte of the input image: `input!(LEVEL: f32, "level", 4);`. Its type is a [`Value`](crate::Value): a
/// number, `bool` (a whole byte), [`Time`](crate::Time), [`Text`](crate::Text), or an array of one of them.
#[macro_export]
macro_rules! input {
    ($vis:vis $ident:ident: $ty:ty, $name:literal, $byte:expr) => {
        $vis static $ident: $crate::Input<$ty> = {
            const BYTE: usize = $byte;
            // SAFETY: it is declared below.
            unsafe { $crate::Input::at(BYTE) }
        };
        $crate::__variable!(
            $name,
            $crate::declaration::INPUT + $byte,
            $ty,
            $crate::declaration::flag::INPUT | $crate::declaration::flag::FORCEABLE,
            0
        );
    };
}

/// Declares a value at a byte of the output image: `output!(VALVE: f32, "valve", 0);`
#[macro_export]
macro_rules! output {
    ($vis:vis $ident:ident: $ty:ty, $name:literal, $byte:expr) => {
        $vis static $ident: $crate::Output<$ty> = {
            const BYTE: usize = $byte;
            // SAFETY: it is declared below.
            unsafe { $crate::Output::at(BYTE) }
        };
        $crate::__variable!(
            $name,
            $crate::declaration::OUTPUT + $byte,
            $ty,
            $crate::declaration::flag::OUTPUT | $crate::declaration::flag::FORCEABLE,
            0
        );
    };
}

/// Declares a value at a byte of the markers, which is seen from outside and belongs to the program alone:
/// `marker!(COUNT: i32, "count", 0);`
#[macro_export]
macro_rules! marker {
    ($vis:vis $ident:ident: $ty:ty, $name:literal, $byte:expr) => {
        $vis static $ident: $crate::Marker<$ty> = {
            const BYTE: usize = $byte;
            // SAFETY: it is declared below.
            unsafe { $crate::Marker::at(BYTE) }
        };
        $crate::__variable!(
            $name,
            $crate::declaration::MARKER + $byte,
            $ty,
            $crate::declaration::flag::FORCEABLE,
            0
        );
    };
}

/// Declares which task writes a point: `writes!("control", "valve");`. Each output of a program with several tasks
/// needs one, so that no two tasks write the same.
#[macro_export]
macro_rules! writes {
    ($task:literal, $point:literal) => {
        $crate::__declare!(
            $crate::declaration::Declaration::new($crate::declaration::kind::WRITES, $task)
                .text($point)
        );
    };
}

/// Declares a bit of the input image: `input_bit!(START, "start", 8, 0);` is `%IX8.0`.
#[macro_export]
macro_rules! input_bit {
    ($vis:vis $ident:ident, $name:literal, $byte:expr, $bit:expr) => {
        $vis static $ident: $crate::InputBit = {
            const PLACE: (usize, u8) = ($byte, $bit);
            // SAFETY: it is declared below.
            unsafe { $crate::InputBit::at(PLACE.0, PLACE.1) }
        };
        $crate::__variable!(
            $name,
            $crate::declaration::INPUT + $byte,
            bool,
            $crate::declaration::flag::INPUT | $crate::declaration::flag::FORCEABLE,
            $bit + 1
        );
    };
}

/// Declares a bit of the output image: `output_bit!(PUMP, "pump", 4, 0);` is `%QX4.0`.
#[macro_export]
macro_rules! output_bit {
    ($vis:vis $ident:ident, $name:literal, $byte:expr, $bit:expr) => {
        $vis static $ident: $crate::OutputBit = {
            const PLACE: (usize, u8) = ($byte, $bit);
            // SAFETY: it is declared below.
            unsafe { $crate::OutputBit::at(PLACE.0, PLACE.1) }
        };
        $crate::__variable!(
            $name,
            $crate::declaration::OUTPUT + $byte,
            bool,
            $crate::declaration::flag::OUTPUT | $crate::declaration::flag::FORCEABLE,
            $bit + 1
        );
    };
}

/// Declares a variable that is seen from outside, with its initial value and, if any, flags of
/// [`declaration::flag`](crate::declaration::flag): `point!(SETPOINT: f32 = 2.0, "setpoint", RETAIN | FORCEABLE);`
#[macro_export]
macro_rules! point {
    ($vis:vis $ident:ident: $ty:ty = $value:expr, $name:literal $(, $($flag:ident)|+)?) => {
        $vis static $ident: $crate::Point<$ty> = $crate::Point::new($value);
        $crate::__variable!(
            $name,
            &raw const $ident,
            $ty,
            0 $($(| $crate::declaration::flag::$flag)+)?,
            0
        );
    };
}

#[doc(hidden)]
#[macro_export]
macro_rules! __object {
    ($vis:vis $ident:ident: $ty:ident, $kind:ident, $name:literal, $a:expr, $b:expr) => {
        $vis static $ident: $crate::$ty = $crate::$ty::new();
        $crate::__declare!(
            $crate::declaration::Declaration::new($crate::declaration::kind::$kind, $name)
                .at(&raw const $ident as *const ())
                .numbers([$a, $b, 0, 0, 0, 0, 0, 0])
        );
    };
}

/// Declares a semaphore: `semaphore!(LOCK, "lock", ceiling = 1);` with the priority of the most urgent task
/// that takes it. A ceiling that is more urgent than all cyclic and event tasks of the program counts as the most urgent of these.
#[macro_export]
macro_rules! semaphore {
    ($vis:vis $ident:ident, $name:literal, ceiling = $ceiling:expr) => {
        $crate::__object!($vis $ident: Semaphore, SEMAPHORE, $name, $ceiling, 0);
    };
}

/// Declares a queue: `queue!(JOBS, "jobs", bytes = 16, depth = 4);`
#[macro_export]
macro_rules! queue {
    ($vis:vis $ident:ident, $name:literal, bytes = $bytes:expr, depth = $depth:expr) => {
        $crate::__object!($vis $ident: Queue, QUEUE, $name, $bytes, $depth);
    };
}

/// Declares a mailbox: `mailbox!(LAST, "last", bytes = 8);`
#[macro_export]
macro_rules! mailbox {
    ($vis:vis $ident:ident, $name:literal, bytes = $bytes:expr) => {
        $crate::__object!($vis $ident: Mailbox, MAILBOX, $name, $bytes, 0);
    };
}

/// Declares event flags: `flags!(EVENTS, "events");`
#[macro_export]
macro_rules! flags {
    ($vis:vis $ident:ident, $name:literal) => {
        $crate::__object!($vis $ident: Flags, FLAGS, $name, 0, 0);
    };
}

/// Declares a channel port that the program reads: `port_in!(ORDERS, "orders", bytes = 64);`
#[macro_export]
macro_rules! port_in {
    ($vis:vis $ident:ident, $name:literal, bytes = $bytes:expr) => {
        $crate::__object!($vis $ident: PortIn, PORT_IN, $name, $bytes, 0);
    };
}

/// Declares a channel port that the program writes: `port_out!(STATUS, "status", bytes = 64);`
#[macro_export]
macro_rules! port_out {
    ($vis:vis $ident:ident, $name:literal, bytes = $bytes:expr) => {
        $crate::__object!($vis $ident: PortOut, PORT_OUT, $name, $bytes, 0);
    };
}

/// Logs a line with numbers: `log!("level {level:.2} m");`. What is longer than a line of the log is cut.
#[macro_export]
macro_rules! log {
    ($($arguments:tt)+) => {
        $crate::line::Line::log(::core::format_args!($($arguments)+))
    };
}
