//! Base addresses, as Linux sizes and moves them.

use super::*;

const WINDOW: RangeInclusive<u32> = 0xd000_0000..=0xd00f_ffff;

fn places<const N: usize>(bytes: [u64; N]) -> Result<[(u32, u32); N], WindowFull> {
    let bars = assign(&WINDOW, bytes)?;
    Ok(bars.map(|bar| (bar.address & 0xf_ffff, bar.size)))
}

#[test]
fn the_largest_lies_first_and_each_is_as_aligned_as_it_is_long() {
    assert_eq!(places([1, 1]), Ok([(0, 0x1000), (0x1000, 0x1000)]));
    assert_eq!(places([1, 0x3000, 0x4000]), Ok([(0x8000, 0x1000), (0, 0x4000), (0x4000, 0x4000)]));
    assert_eq!(places([1, 0x1000, 0x1001]), Ok([(0x2000, 0x1000), (0x3000, 0x1000), (0, 0x2000)]));
    let odd = assign(&(0xd000_3000..=0xd00f_ffff), [0x3000]);
    assert_eq!(odd.unwrap()[0].address, 0xd000_4000);
}

#[test]
fn what_does_not_fit_is_refused() {
    for bytes in [0x10_0001, 1 << 31, (1 << 31) + 1, 1 << 32, u64::MAX] {
        assert_eq!(places([bytes]), Err(WindowFull { bytes, window: WINDOW }));
    }
    assert!(places([0x8_0000, 0x8_0000]).is_ok());
    let full = places([0x8_0000, 1, 0x8_0000]).unwrap_err();
    assert_eq!(full.to_string(), "no room for 0x1 bytes of PCI memory in 0xd0000000 to 0xd00fffff");
    let top = 0xffff_f000..=u32::MAX;
    assert!(assign(&top, [1]).is_ok());
    assert!(assign(&top, [1, 1]).is_err());
}

#[test]
fn a_guest_learns_the_size_and_finds_the_address_again() {
    let [_, mut bar] = assign(&WINDOW, [0x3000, 0x4000]).unwrap();
    let original = bar.read();
    assert_eq!(original, 0xd000_4008);
    bar.write(u32::MAX, u32::MAX);
    assert_eq!(bar.read(), 0xffff_c008);
    bar.write(original, u32::MAX);
    assert_eq!(bar.read(), original);
}

#[test]
fn a_guest_cannot_move_the_memory() {
    let [mut bar] = assign(&WINDOW, [1]).unwrap();
    for (value, bytes) in [(0, u32::MAX), (0xe000_0000, u32::MAX), (0x12, 0xff), (!0, 0xff00)] {
        bar.write(value, bytes);
        assert_eq!(bar.read(), 0xd000_0008, "{value:#x} {bytes:#x}");
    }
}
