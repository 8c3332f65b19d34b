//! The values of literals, from their text.
//!
//! Forms and ranges that a literal has whatever its type are checked here: the digits of its base, the
//! order of the units of a duration, the days of a month. A wrong one becomes an error with its reason.

use std::fmt::Write;

use super::ast::LiteralValue;

/// Why a literal is none: what was found, and what is allowed.
pub type Wrong = (String, &'static str);

const SECOND: u64 = 1_000_000_000;
const DAY: u64 = 86_400 * SECOND;

/// Decimal digits with underscores.
///
/// # Errors
///
/// If it does not fit 64 bits.
pub fn integer(text: &str) -> Result<LiteralValue, Wrong> {
    digits(text, 10).map(LiteralValue::Integer)
}

/// `base#digits`.
///
/// # Errors
///
/// If the base is none of the standard's, a digit is not of that base, or it does not fit 64 bits.
pub fn based(text: &str) -> Result<LiteralValue, Wrong> {
    let (base, body) = text.split_once('#').unwrap_or((text, ""));
    let base = match base {
        "2" => 2,
        "8" => 8,
        "10" => 10,
        "16" => 16,
        _ => return Err((format!("the base {base}"), "2, 8, 10 or 16")),
    };
    digits(body, base).map(LiteralValue::Integer)
}

fn digits(text: &str, base: u32) -> Result<u64, Wrong> {
    const FORM: &str = "digits of the base, single underscores between them";
    if text.is_empty() || text.starts_with('_') || text.ends_with('_') || text.contains("__") {
        return Err((format!("`{}` as a number", cut(text)), FORM));
    }
    let mut value = 0_u64;
    for digit in text.chars().filter(|c| *c != '_') {
        let Some(number) = digit.to_digit(base) else {
            return Err((format!("the digit `{digit}` in a number of base {base}"), FORM));
        };
        value = value
            .checked_mul(u64::from(base))
            .and_then(|value| value.checked_add(u64::from(number)))
            .ok_or((format!("the number {} is too large", cut(text)), "at most 64 bits"))?;
    }
    Ok(value)
}

/// A number with a point.
///
/// # Errors
///
/// If it is out of LREAL's range.
pub fn real(text: &str) -> Result<LiteralValue, Wrong> {
    let plain: String = text.chars().filter(|c| *c != '_').collect();
    match (plain.parse::<f64>(), plain.parse::<f32>()) {
        (Ok(long), Ok(short)) if long.is_finite() => Ok(LiteralValue::Real { long, short }),
        _ => Err((format!("the number {}", cut(text)), "at most about 1.8E308")),
    }
}

/// `T#...`, `LTIME#...`.
///
/// # Errors
///
/// If a unit is unknown or out of order, a fraction is not at the end, or it is more than 64 bits of
/// nanoseconds.
pub fn duration(text: &str) -> Result<LiteralValue, Wrong> {
    const FORM: &str = "numbers with the units d, h, m, s, ms, us, ns in this order, each at most once; only the \
         last may have a fraction: `T#1h30m`, `T#1.5s`, `T#250ms`";
    const RANGE: &str = "at most 292 years (64 bits of nanoseconds)";
    const UNITS: [(&str, u64); 7] = [
        ("d", DAY),
        ("h", 3600 * SECOND),
        ("m", 60 * SECOND),
        ("s", SECOND),
        ("ms", 1_000_000),
        ("us", 1000),
        ("ns", 1),
    ];
    let wrong = || (format!("`{}` as a duration", cut(text)), FORM);
    let (long, body) = prefix(text);
    let (negative, body) = match body.strip_prefix('-') {
        Some(body) => (true, body),
        None => (false, body.strip_prefix('+').unwrap_or(body)),
    };
    let body = body.to_ascii_lowercase();
    let (mut rest, mut next_unit, mut ended) = (body.as_str(), 0, false);
    let mut total = 0_u128;
    if rest.is_empty() {
        return Err(wrong());
    }
    while !rest.is_empty() {
        let number_end = rest.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(rest.len());
        let (number, behind) = rest.split_at(number_end);
        let unit_end = behind.find(|c: char| !c.is_ascii_alphabetic()).unwrap_or(behind.len());
        let (unit, behind) = behind.split_at(unit_end);
        let place = UNITS.iter().position(|(name, _)| *name == unit).ok_or_else(wrong)?;
        if ended || place < next_unit {
            return Err(wrong());
        }
        next_unit = place + 1;
        let (whole, fraction) = number.split_once('.').unwrap_or((number, ""));
        let whole = whole.strip_prefix('_').unwrap_or(whole);
        let scale = u128::from(UNITS[place].1);
        total += u128::from(digits(whole, 10).map_err(|_| wrong())?) * scale;
        if number.contains('.') {
            ended = true;
            // Below a nanosecond nothing is kept; 18 digits are below one of any unit.
            let kept = fraction.get(..fraction.len().min(18)).unwrap_or("");
            let value = digits(kept, 10).map_err(|_| wrong())?;
            let places = kept.chars().filter(|c| *c != '_').count() as u32;
            total += u128::from(value) * scale / 10_u128.pow(places);
        }
        rest = behind.strip_prefix('_').unwrap_or(behind);
    }
    // With its sign, because the least has no positive counterpart.
    let signed = i128::try_from(total).map(|total| if negative { -total } else { total });
    let nanoseconds = signed
        .and_then(i64::try_from)
        .map_err(|_| (format!("the duration {}", cut(text)), RANGE))?;
    Ok(LiteralValue::Duration { nanoseconds, long })
}

/// `D#2026-11-22`.
///
/// # Errors
///
/// If there is no such day, or it is out of range.
pub fn date(text: &str) -> Result<LiteralValue, Wrong> {
    let (long, body) = prefix(text);
    Ok(LiteralValue::Date { nanoseconds: day(body, text)?, long })
}

/// `TOD#23:59:59.999`.
///
/// # Errors
///
/// If there is no such time.
pub fn time_of_day(text: &str) -> Result<LiteralValue, Wrong> {
    let (long, body) = prefix(text);
    Ok(LiteralValue::TimeOfDay { nanoseconds: clock(body, text)?, long })
}

/// `DT#2026-11-22-23:59:59`.
///
/// # Errors
///
/// If there is no such day or time, or it is out of range.
pub fn date_and_time(text: &str) -> Result<LiteralValue, Wrong> {
    let (long, body) = prefix(text);
    let (date, time) = body.rsplit_once('-').unwrap_or((body, ""));
    let nanoseconds = day(date, text)?.checked_add(clock(time, text)?);
    Ok(LiteralValue::DateAndTime { nanoseconds: nanoseconds.ok_or_else(|| no_day(text))?, long })
}

fn no_day(text: &str) -> Wrong {
    (format!("`{}` as a date", cut(text)), "`YYYY-MM-DD` from 1970-01-01 to 2262-04-10")
}

/// Nanoseconds from 1970-01-01 to the start of a day.
fn day(body: &str, text: &str) -> Result<i64, Wrong> {
    let parts: Vec<&str> = body.split('-').collect();
    let [year, month, day] = parts[..] else { return Err(no_day(text)) };
    let (Ok(year), Ok(month), Ok(day)) = (digits(year, 10), digits(month, 10), digits(day, 10))
    else {
        return Err(no_day(text));
    };
    let leap = |year: u64| {
        year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400))
    };
    let length = match month {
        2 if leap(year) => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        1..=12 => 31,
        _ => 0,
    };
    if !(1970..=2262).contains(&year) || day == 0 || day > length {
        return Err(no_day(text));
    }
    // Days before the month in a year without a leap day.
    let before = [0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334][month as usize - 1];
    let leap_days =
        (1970..year).filter(|year| leap(*year)).count() as u64 + u64::from(month > 2 && leap(year));
    let days = (year - 1970) * 365 + leap_days + before + day - 1;
    // The last day that ends within 64 bits of nanoseconds.
    if days > i64::MAX as u64 / DAY - 1 {
        return Err(no_day(text));
    }
    Ok((days * DAY) as i64)
}

/// Nanoseconds from midnight.
fn clock(body: &str, text: &str) -> Result<i64, Wrong> {
    let wrong = || (format!("`{}` as a time", cut(text)), "`HH:MM:SS` or `HH:MM:SS.fraction`");
    let parts: Vec<&str> = body.split(':').collect();
    let [hours, minutes, seconds] = parts[..] else { return Err(wrong()) };
    let (seconds, fraction) = seconds.split_once('.').unwrap_or((seconds, "0"));
    let number = |text: &str, limit: u64| match digits(text, 10) {
        Ok(value) if value < limit => Ok(value),
        _ => Err(wrong()),
    };
    let plain: String = fraction.chars().filter(|c| *c != '_').take(9).collect();
    let part = number(&plain, u64::MAX)? * 10_u64.pow(9 - plain.len() as u32);
    let whole = number(hours, 24)? * 3600 + number(minutes, 60)? * 60 + number(seconds, 60)?;
    Ok((whole * SECOND + part) as i64)
}

/// Whether the type before the `#` is a long one, and what is behind it.
fn prefix(text: &str) -> (bool, &str) {
    let (name, body) = text.split_once('#').unwrap_or(("", text));
    (name.starts_with(['L', 'l']), body)
}

/// The characters of `'...'`: Latin-1, as the first row of ISO/IEC 10646.
///
/// # Errors
///
/// If an escape is unknown or a character is not of one byte.
pub fn string(text: &str) -> Result<LiteralValue, Wrong> {
    let units = characters(text, '\'', 2)?;
    let mut bytes = Vec::with_capacity(units.len());
    for unit in units {
        bytes.push(u8::try_from(unit).map_err(|_| {
            let shown = char::from_u32(unit).unwrap_or('?');
            (
                format!("the character `{shown}` in a STRING"),
                "characters of one byte (Latin-1); a WSTRING in double quotes has 16 bits",
            )
        })?);
    }
    Ok(LiteralValue::String(bytes))
}

/// The characters of `"..."`.
///
/// # Errors
///
/// If an escape is unknown or a character has more than 16 bits.
pub fn wide_string(text: &str) -> Result<LiteralValue, Wrong> {
    let units = characters(text, '"', 4)?;
    let mut wide = Vec::with_capacity(units.len());
    for unit in units {
        wide.push(u16::try_from(unit).map_err(|_| {
            let shown = char::from_u32(unit).unwrap_or('?');
            (format!("the character `{shown}` in a WSTRING"), "characters of 16 bits")
        })?);
    }
    Ok(LiteralValue::WideString(wide))
}

/// The characters between the quotes; `hex` digits make one of `$hh`.
fn characters(text: &str, quote: char, hex: usize) -> Result<Vec<u32>, Wrong> {
    let body = text.strip_prefix(quote).unwrap_or(text);
    let body = body.strip_suffix(quote).unwrap_or(body);
    let mut out = Vec::with_capacity(body.len());
    let mut rest = body.chars();
    while let Some(c) = rest.next() {
        if c != '$' {
            out.push(u32::from(c));
            continue;
        }
        let escape = rest.clone().next().unwrap_or(' ');
        let single = match escape.to_ascii_uppercase() {
            '$' | '\'' | '"' => Some(escape),
            'L' | 'N' => Some('\n'),
            'P' => Some('\x0C'),
            'R' => Some('\r'),
            'T' => Some('\t'),
            _ => None,
        };
        if let Some(single) = single {
            rest.next();
            out.push(u32::from(single));
            continue;
        }
        let code: String = rest.by_ref().take(hex).collect();
        match u32::from_str_radix(&code, 16) {
            Ok(value) if code.len() == hex && !code.starts_with('+') => out.push(value),
            _ => {
                return Err((
                    format!("the escape `${}`", cut(&code)),
                    "`$$ $' $\" $L $N $P $R $T`, or `$` and two digits in a STRING, four in a \
                     WSTRING, of base 16",
                ));
            }
        }
    }
    Ok(out)
}

/// A text of any length, fit for a message.
fn cut(text: &str) -> String {
    let mut shown: String = text.chars().take(40).collect();
    if shown.len() < text.len() {
        let _ = write!(shown, "...");
    }
    shown
}

#[cfg(test)]
#[path = "literal_tests.rs"]
mod tests;
