//! Values as one writes them in Structured Text.

use takt_points::digits;
use takt_program::{Nanoseconds, address};
use takt_st::hir::{Class, Elementary, GlobalId, Program, Type, TypeId};

use crate::run::Machine;

const DAY: i64 = 86_400_000_000_000;

/// The value of a variable of the state.
pub fn shown(program: &Program, machine: &Machine<'_>, id: GlobalId, ty: TypeId) -> String {
    let at = address::STATE + u64::from(program.global(id).storage.offset);
    let bytes = machine.get(at, program.types.size(ty).into()).unwrap_or_default();
    match program.types.get(ty) {
        Type::String { .. } => {
            let text = bytes.iter().take_while(|byte| **byte != 0).map(|byte| char::from(*byte));
            format!("'{}'", text.flat_map(char::escape_debug).collect::<String>())
        }
        Type::WString { .. } => {
            let units = bytes.chunks_exact(2).map(|unit| u16::from_le_bytes([unit[0], unit[1]]));
            let units: Vec<u16> = units.take_while(|unit| *unit != 0).collect();
            format!("\"{}\"", String::from_utf16_lossy(&units).escape_debug())
        }
        kind => {
            let mut word = [0; 8];
            word.iter_mut().zip(&bytes).for_each(|(to, from)| *to = *from);
            let raw = u64::from_le_bytes(word);
            match (kind, program.types.scalar(ty)) {
                (Type::Reference { .. }, _) if raw == 0 => "NULL".to_owned(),
                (Type::Reference { .. }, _) => format!("a reference ({raw:#x})"),
                (Type::Enumeration { values, base, .. }, _) => {
                    let number = integer(raw, *base);
                    let name = values.iter().find(|(_, value)| *value == number);
                    name.map_or_else(|| number.to_string(), |(name, _)| name.clone())
                }
                (_, Some(elementary)) => scalar(raw, elementary),
                (_, None) => "a value of several parts".to_owned(),
            }
        }
    }
}

fn integer(raw: u64, elementary: Elementary) -> i128 {
    elementary.wrap(i128::from(raw))
}

fn scalar(raw: u64, elementary: Elementary) -> String {
    use Elementary as E;
    let signed = raw.cast_signed();
    match elementary {
        E::Bool => if raw & 1 == 1 { "TRUE" } else { "FALSE" }.to_owned(),
        E::Real => digits(f32::from_bits(raw as u32)),
        E::Lreal => digits(f64::from_bits(raw)),
        E::Byte | E::Word | E::Dword | E::Lword => {
            format!("16#{raw:0width$X}", width = elementary.size() as usize * 2)
        }
        E::Char | E::Wchar => match char::from_u32(raw as u32) {
            Some(c) => format!("'{}'", c.escape_debug()),
            None => format!("16#{raw:X}"),
        },
        E::Time | E::Ltime => {
            let sign = if signed < 0 { "-" } else { "" };
            let shown = Nanoseconds(signed.unsigned_abs()).to_string().replace(' ', "");
            format!("T#{sign}{shown}")
        }
        E::Date | E::Ldate => format!("D#{}", day(signed)),
        E::Tod | E::Ltod => format!("TOD#{}", clock(signed)),
        E::Dt | E::Ldt => format!("DT#{}-{}", day(signed), clock(signed.rem_euclid(DAY))),
        _ => {
            debug_assert!(elementary.class() != Class::Float);
            integer(raw, elementary).to_string()
        }
    }
}

/// The day of a time since 1970 (Hinnant, "chrono-compatible low-level date algorithms", civil_from_days).
fn day(nanoseconds: i64) -> String {
    let days = nanoseconds.div_euclid(DAY) + 719_468;
    let (era, of_era) = (days.div_euclid(146_097), days.rem_euclid(146_097));
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    let year = year + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

fn clock(nanoseconds: i64) -> String {
    let (seconds, rest) =
        (nanoseconds.div_euclid(1_000_000_000), nanoseconds.rem_euclid(1_000_000_000));
    let fraction = format!("{rest:09}");
    let fraction = fraction.trim_end_matches('0');
    let point = if fraction.is_empty() { "" } else { "." };
    format!("{:02}:{:02}:{:02}{point}{fraction}", seconds / 3600, seconds / 60 % 60, seconds % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_shown_as_their_literals() {
        for (raw, elementary, text) in [
            (1, Elementary::Bool, "TRUE"),
            (0xffff_fffe, Elementary::Dint, "-2"),
            (0xff, Elementary::Byte, "16#FF"),
            (1_500_000_000, Elementary::Time, "T#1500ms"),
            (0, Elementary::Date, "D#1970-01-01"),
            (951_782_400 * 1_000_000_000, Elementary::Date, "D#2000-02-29"),
            (3_661_500_000_000, Elementary::Tod, "TOD#01:01:01.5"),
            (DAY as u64 + 1_000_000_000, Elementary::Dt, "DT#1970-01-02-00:00:01"),
            (u64::from(2.5_f32.to_bits()), Elementary::Real, "2.5"),
        ] {
            assert_eq!(scalar(raw, elementary), text);
        }
    }
}
