//! What literals mean: durations, dates, numbers, strings.

use super::*;

fn nanoseconds(value: Result<LiteralValue, Wrong>) -> Option<i64> {
    match value {
        Ok(
            LiteralValue::Duration { nanoseconds, .. }
            | LiteralValue::Date { nanoseconds, .. }
            | LiteralValue::TimeOfDay { nanoseconds, .. }
            | LiteralValue::DateAndTime { nanoseconds, .. },
        ) => Some(nanoseconds),
        _ => None,
    }
}

#[test]
fn every_form_of_a_duration_is_its_nanoseconds() {
    for (text, expected) in [
        ("T#14ms", 14_000_000),
        ("T#-14ms", -14_000_000),
        ("LT#-9223372036854775808ns", i64::MIN),
        ("LT#14.7s", 14_700_000_000),
        ("TIME#1.5h", 5_400_000_000_000),
        ("T#25h_15m", 90_900_000_000_000),
        ("t#5d14h12m18s3.5ms", 483_138_003_500_000),
        ("LTIME#5m_30s_500ms_100.1us", 330_500_100_100),
        ("T#49d17h", 4_294_800_000_000_000),
        ("T#0.000000000000000001d", 0),
        ("T#1_000ms", 1_000_000_000),
    ] {
        assert_eq!(nanoseconds(duration(text)), Some(expected), "{text}");
    }
}

#[test]
fn a_duration_of_wrong_form_is_refused() {
    for text in [
        "T#",
        "T#5",
        "T#5x",
        "T#1s1m",
        "T#1s1s",
        "T#1.5s3ms",
        "T#-",
        "T#1.s",
        "T#106752d",
        "T#.5s",
        "T#99999999999999999999999s",
        "T#1__0s",
    ] {
        assert!(duration(text).is_err(), "{text}");
    }
}

#[test]
fn dates_are_counted_from_1970() {
    assert_eq!(nanoseconds(date("D#1970-01-02")), Some(86_400_000_000_000));
    assert_eq!(nanoseconds(date("DATE#2000-03-01")), Some(951_868_800_000_000_000));
    assert_eq!(
        nanoseconds(date_and_time("DT#2001-09-09-01:46:40")),
        Some(SECOND as i64 * 1_000_000_000)
    );
    assert_eq!(nanoseconds(time_of_day("TOD#23:59:59.25")), Some(86_399_250_000_000));
    assert_eq!(nanoseconds(time_of_day("LTOD#00:00:00.000000001")), Some(1));
}

#[test]
fn days_and_times_that_do_not_exist_are_refused() {
    for text in
        ["D#2023-02-29", "D#1900-01-01", "D#2026-13-01", "D#2026-00-01", "D#2026-1", "D#2262-04-12"]
    {
        assert!(date(text).is_err(), "{text}");
    }
    for text in ["TOD#24:00:00", "TOD#1:60:00", "TOD#1:00", "TOD#1:2:3.", "TOD#::"] {
        assert!(time_of_day(text).is_err(), "{text}");
    }
    for text in ["DT#2026-01-01", "DT#", "DT#2026-01-01-24:00:00"] {
        assert!(date_and_time(text).is_err(), "{text}");
    }
}

#[test]
fn numbers_of_all_bases() {
    for (text, expected) in
        [("16#FF", 255), ("2#1111_0000", 240), ("8#377", 255), ("16#FFFF_FFFF_FFFF_FFFF", u64::MAX)]
    {
        assert_eq!(based(text), Ok(LiteralValue::Integer(expected)), "{text}");
    }
    for text in
        ["3#1", "16#", "2#2", "8#9", "16#_1", "16#1_", "16#1__0", "16#1_0000_0000_0000_0000"]
    {
        assert!(based(text).is_err(), "{text}");
    }
    assert!(integer("18446744073709551615").is_ok());
    assert!(integer("18446744073709551616").is_err());
    assert!(real("1.0E400").is_err());
}

#[test]
fn strings_have_the_escapes_of_the_standard() {
    assert_eq!(
        string("'a$$$'$\"$L$n$P$R$T$41ä'"),
        Ok(LiteralValue::String(b"a$'\"\n\n\x0C\r\tA\xE4".to_vec()))
    );
    assert_eq!(wide_string("\"$0041€\""), Ok(LiteralValue::WideString(vec![0x41, 0x20AC])));
    for text in ["'$'", "'$4'", "'$4G'", "'$+1'", "'€'", "'$Z'"] {
        assert!(string(text).is_err(), "{text}");
    }
    assert!(wide_string("\"😀\"").is_err());
}
