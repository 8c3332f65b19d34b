//! Values that the user has written, for points of a PLC that runs.

use takt_points::{Kind, Point, number_of, shown};

use crate::value::{self, Value};

/// A value of its type that is written as this text.
pub fn constant(point: &Point, text: &str) -> Result<Value, String> {
    let none = || format!("a {} cannot be compared", point.type_name);
    let base = point.base().ok_or_else(none)?;
    let (bits, _) = parse(point, text)?;
    Ok(Value::from_raw(base, None, bits))
}

/// The bytes of a value that is written as this text, and the text as it is told to others.
pub fn parse(point: &Point, text: &str) -> Result<(u64, String), String> {
    let (base, value) = match &point.kind {
        Kind::Elementary(elementary) => (*elementary, value::parse(*elementary, text)?),
        Kind::Subrange(base, low, high) => {
            let value = value::parse(*base, text)?;
            let inside = match value {
                Value::Unsigned(number) => {
                    (low.cast_unsigned()..=high.cast_unsigned()).contains(&number)
                }
                Value::Signed(number) => (*low..=*high).contains(&number),
                _ => false,
            };
            if !inside {
                let (low, high) = (number_of(*base, *low), number_of(*base, *high));
                return Err(format!("found `{text}`; {} is {low} to {high}", point.type_name));
            }
            (*base, value)
        }
        Kind::Enumeration(base, names) => {
            let named = names.iter().find(|(name, _)| name.eq_ignore_ascii_case(text));
            let value = match named {
                Some((_, number)) => number_of(*base, *number),
                None => value::parse(*base, text).map_err(|_| {
                    let all: Vec<&str> = names.iter().map(|(name, _)| &**name).collect();
                    format!("found `{text}`; {} is {}", point.type_name, all.join(", "))
                })?,
            };
            (*base, value)
        }
        _ => return Err(format!("a {} cannot be written or forced", point.type_name)),
    };
    let told = match &point.kind {
        Kind::Enumeration(..) => point.show(&value.raw(base).to_le_bytes()),
        _ => shown(base, value),
    };
    Ok((value.raw(base), told))
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_points::Search;
    use takt_program::build::{self, Builder, Task, Type, Variable};
    use takt_program::{Area, CodeOffset, Elementary, Image, Nanoseconds};

    /// `level : REAL; count : INT; on AT %QX3.5 : BOOL; step : (idle := 0, filling := -2); share : SINT (-5..100)`.
    fn image() -> Vec<u8> {
        let mut image = Builder::new("tank");
        image.code = vec![0xc3];
        image.state_bytes = 24;
        image.output_bytes = 8;
        let values = vec![("idle".to_owned(), 0), ("filling".to_owned(), -2)];
        let step = build::Kind::Enumeration { base: Elementary::Sint, values };
        let step = image.ty(Type::new(1, step).named("STEP"));
        let share = build::Kind::Subrange { base: Elementary::Sint, low: -5, high: 100 };
        let share = image.ty(Type::new(1, share));
        image.task(Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0)));
        let real = image.elementary(Elementary::Real);
        let lreal = image.elementary(Elementary::Lreal);
        let int = image.elementary(Elementary::Int);
        let bool = image.elementary(Elementary::Bool);
        image.variable(Variable::new("level", real, Area::State, 0));
        image.variable(Variable::new("count", int, Area::State, 4));
        image.variable(Variable::new("step", step, Area::State, 8));
        image.variable(Variable::new("share", share, Area::State, 9));
        image.variable(Variable::new("volume", lreal, Area::State, 16));
        image.variable(Variable { bit: Some(5), ..Variable::new("on", bool, Area::Output, 3) });
        image.build().unwrap()
    }

    #[test]
    fn values_are_taken_as_they_are_shown() {
        let bytes = image();
        let image = Image::parse(&bytes).unwrap();
        let one = |name: &str| Search::run("tank", 1, &image, name).unwrap().remove(0);
        for (name, text, bits) in [
            ("tank.level", "0.1", u64::from(0.1_f32.to_bits())),
            ("tank.count", "-3", 0xffff_fffd),
            ("tank.step", "filling", 0xffff_fffe),
            ("tank.share", "-5", 0xffff_fffb),
            ("tank.on", "TRUE", 1),
        ] {
            let (raw, told) = parse(&one(name), text).unwrap();
            assert_eq!((raw & 0xffff_ffff, told.as_str()), (bits, text), "{name}");
        }
        let refused = |name: &str, text: &str| parse(&one(name), text).unwrap_err();
        assert_eq!(refused("tank.step", "full"), "found `full`; STEP is idle, filling");
        assert_eq!(refused("tank.share", "101"), "found `101`; SINT is -5 to 100");
    }

    #[test]
    fn numbers_at_the_ends_of_their_types_come_back_and_fit_into_an_order() {
        let bytes = image();
        let image = Image::parse(&bytes).unwrap();
        let one = |name: &str| Search::run("tank", 1, &image, name).unwrap().remove(0);
        let (level, volume) = (one("tank.level"), one("tank.volume"));
        let reals = [f32::MAX, f32::MIN_POSITIVE, f32::from_bits(1), -0.0, f32::INFINITY, 1e16];
        let lreals = [f64::MAX, f64::MIN_POSITIVE, -f64::from_bits(1), 1e300, 0.1, f64::INFINITY];
        let reals = reals.map(|real| (&level, u64::from(real.to_bits())));
        for (point, bits) in reals.into_iter().chain(lreals.map(|lreal| (&volume, lreal.to_bits())))
        {
            let shown = point.show(&bits.to_le_bytes());
            let (again, told) = parse(point, &shown).unwrap();
            assert_eq!((again, &told), (bits, &shown));
            assert!(told.len() <= 30, "{told}");
        }
        // This text lies beside the middle of two REALs, and an LREAL lies on it.
        let (bits, _) = parse(&level, "1.00000005960464477540").unwrap();
        assert_eq!(bits, u64::from(0x3f80_0001_u32));
        for (point, text) in [(&level, "1e39"), (&level, "-1e400"), (&volume, "1e309")] {
            let found = parse(point, text).unwrap_err();
            assert!(
                found.starts_with(&format!("found `{text}`, which is too large for ")),
                "{found}"
            );
        }
    }

    #[test]
    fn a_text_is_told_to_be_none_that_can_be_compared() {
        let text = Point { kind: Kind::Text, type_name: "STRING".into(), ..any() };
        assert_eq!(constant(&text, "'a'").unwrap_err(), "a STRING cannot be compared");
    }

    fn any() -> Point {
        let bytes = image();
        let image = Image::parse(&bytes).unwrap();
        Search::run("tank", 1, &image, "tank.level").unwrap().remove(0)
    }
}
