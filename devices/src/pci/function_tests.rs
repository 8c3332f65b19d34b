//! The function, as the kernel and its driver look at it.

use super::*;

const DISABLE: u32 = 1 << 10;

/// A function with base addresses `0xd000_4000` and `0xd000_0000`.
pub fn function() -> Function {
    Function::new(Bars::assign(&(0xd000_0000..=0xdfff_ffff), 0x1000, 0x4000).unwrap())
}

#[test]
fn linux_finds_what_its_driver_needs() {
    let mut function = function();
    assert_eq!(function.read(Register::IDENTITY), 0x10f0_1af4);
    assert_eq!(function.read(Register::CLASS), 0x05_80_00_01);
    assert_eq!(function.read(Register::INTERRUPT) >> 8 & 0xff, 1);
    let bars = [0, 1, 2, 3, 4, 5].map(|n| function.read(Register(Register::BAR_0.0 + n)));
    assert_eq!(bars, [0, 0xd000_4008, 0xd000_0008, 0, 0, 0]);
}

#[test]
fn the_disable_bit_and_no_other_can_be_toggled_as_linux_tries_it() {
    let mut function = function();
    let before = function.read(Register::COMMAND_STATUS);
    function.write(Register::COMMAND_STATUS, before ^ DISABLE, 0xffff);
    assert_eq!(function.read(Register::COMMAND_STATUS), before ^ DISABLE);
    function.write(Register::COMMAND_STATUS, u32::MAX, u32::MAX);
    assert_eq!(function.read(Register::COMMAND_STATUS), 0x0008_0402);
}

#[test]
fn an_interrupt_is_always_shown_so_that_the_driver_wakes_its_reader() {
    let mut function = function();
    for command in [0, DISABLE, u32::MAX, 0] {
        function.write(Register::COMMAND_STATUS, command, u32::MAX);
        assert_eq!(function.read(Register::COMMAND_STATUS) >> 19 & 1, 1);
    }
}
