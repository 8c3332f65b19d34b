//! Values that would fit, but not on the way. On the interpreter and as machine code, as in `language`.

use takt_st::hir::TrapKind;

use crate::language::{program, wrong};
use crate::oracle::Job;
use crate::program::Twice;

/// A string of 200 characters and one of 400.
const TEXTS: &str = "PROGRAM Main
    VAR s : STRING[255]; long : STRING[400]; short : STRING[100] := 'short'; si, i : SINT; us : USINT; n : INT; r : REAL; END_VAR
    VAR d : DINT; k : INT; l : LINT; END_VAR";
const FILL: &str = "FOR k := 1 TO 200 DO s := CONCAT(s, 'x'); long := CONCAT(long, 'xy'); END_FOR;";

#[test]
fn lengths_do_not_wrap_before_they_are_computed_with() {
    let statements = format!(
        "{FILL}
        si := DINT_TO_SINT(LEN(s) / 10); IF si <> 20 THEN wrong := wrong + 1; END_IF;
        us := LEN(s) / 10; IF us <> 20 THEN wrong := wrong + 2; END_IF;
        us := LEN(s); IF us <> 200 THEN wrong := wrong + 4; END_IF;
        us := DINT_TO_USINT(MIN(LEN(long), 200)); IF us <> 200 THEN wrong := wrong + 8; END_IF;
        si := LEN(short) - 1; IF si <> 4 THEN wrong := wrong + 16; END_IF;
        n := LEN(long) - 1; IF n <> 399 THEN wrong := wrong + 32; END_IF;
        us := FIND(s, 'x') + 1; IF us <> 2 THEN wrong := wrong + 64; END_IF;
        si := DINT_TO_SINT(TRUNC(200.0) / 10); IF si <> 20 THEN wrong := wrong + 128; END_IF;
        si := TRUNC(200.0); IF si <> 127 THEN wrong := wrong + 256; END_IF;
        l := TRUNC(1.0E12) / 10; IF l <> 100000000000 THEN wrong := wrong + 512; END_IF;"
    );
    assert_eq!(wrong(TEXTS, &statements), 0);
}

#[test]
fn a_length_that_does_not_fit_is_a_trap() {
    for statement in [
        "si := LEN(s);",
        "us := (LEN(long));",
        "us := FIND(long, 'no'); us := FIND(CONCAT(long, 'no'), 'no');",
        "FOR si := 1 TO LEN(s) DO d := d + 1; END_FOR;",
    ] {
        let program = program(TEXTS, &format!("{FILL} {statement}"));
        let trap = Twice::start(&program).trap(Job::default());
        assert_eq!(trap.kind, TrapKind::Subrange, "{statement}");
    }
}

#[test]
fn numbers_beside_bits_are_as_wide_whatever_the_order() {
    let declarations = "PROGRAM Main VAR w, x : WORD := 16#FF01; d : DWORD; b : BYTE := 1; q : BOOL; n : INT := 8; END_VAR";
    let statements = "
        w := SHL(16#FF, 8) OR b; IF w <> 16#FF01 THEN wrong := wrong + 1; END_IF;
        w := b OR SHL(16#FF, 8); IF w <> 16#FF01 THEN wrong := wrong + 2; END_IF;
        w := b OR NOT 16#0F; IF w <> 16#FFF1 THEN wrong := wrong + 4; END_IF;
        w := NOT 16#0F OR b; IF w <> 16#FFF1 THEN wrong := wrong + 8; END_IF;
        w := 16#2;
        IF (w AND NOT 1) = 0 THEN wrong := wrong + 16; END_IF;
        IF (NOT 1 AND w) = 0 THEN wrong := wrong + 32; END_IF;
        IF NOT 1 AND NOT (w = 2) THEN wrong := wrong + 64; END_IF;
        w := 16#FFFF; IF w <> NOT 0 OR NOT 0 <> w THEN wrong := wrong + 128; END_IF;
        IF (16#FF AND 3) <> (x AND 16#FF OR 2) THEN wrong := wrong + 256; END_IF;
        d := w AND NOT 1; IF d <> 16#FFFE THEN wrong := wrong + 512; END_IF;
        d := NOT 1 XOR w; IF d <> 16#FFFF_0001 THEN wrong := wrong + 1024; END_IF;
        d := w XOR NOT 1; IF d <> 16#FFFF_0001 THEN wrong := wrong + 2048; END_IF;
        q := NOT 0; IF NOT q OR q = NOT 1 OR NOT 1 = q THEN wrong := wrong + 4096; END_IF;
        IF (NOT 1 OR b OR w) <> (w OR b OR NOT 1) OR (NOT 1 OR b) <> (x OR w) THEN wrong := wrong + 16384; END_IF;
        IF SHL(1, n) <> (x AND 16#100) THEN wrong := wrong + 8192; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn powers_are_computed_in_lreal_unless_a_side_or_the_target_is_a_real() {
    let declarations =
        "PROGRAM Main VAR n : INT := 2; i : INT := 5001; l : LREAL; r : REAL; d : DINT; END_VAR";
    let statements = "
        l := 1.1 ** n; IF ABS(l - 1.21) > 1.0E-12 THEN wrong := wrong + 1; END_IF;
        l := 10.0 ** -n; IF ABS(l - 0.01) > 1.0E-15 THEN wrong := wrong + 2; END_IF;
        d := LREAL_TO_DINT(i ** 2); IF d <> 25010001 THEN wrong := wrong + 4; END_IF;
        l := EXPT(1.1, n); IF ABS(l - 1.21) > 1.0E-12 THEN wrong := wrong + 8; END_IF;
        r := n ** 3 + 2.0 * 3.0 ** n; IF r <> REAL#26.0 THEN wrong := wrong + 16; END_IF;
        r := 2.0 ** 3.0; IF r <> REAL#8.0 THEN wrong := wrong + 32; END_IF;
        d := REAL_TO_DINT(n ** 3); IF d <> 8 THEN wrong := wrong + 64; END_IF;
        l := r ** n; IF l <> 64.0 THEN wrong := wrong + 128; END_IF;
        d := TRUNC(i ** 2); IF d <> 25010001 THEN wrong := wrong + 256; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn a_time_before_1970_lies_in_the_day_before() {
    let declarations = "PROGRAM Main VAR year, month, day, hour, minute : INT; END_VAR";
    let statements = "
        SPLIT_DT(IN := DT#1970-01-01-00:00:00 - T#5h, YEAR => year, MONTH => month, DAY => day, HOUR => hour);
        IF year <> 1969 OR month <> 12 OR day <> 31 OR hour <> 19 THEN wrong := wrong + 1; END_IF;
        SPLIT_LDT(IN := LINT_TO_LDT(-86400000000000), YEAR => year, MONTH => month, DAY => day, HOUR => hour);
        IF year <> 1969 OR month <> 12 OR day <> 31 OR hour <> 0 THEN wrong := wrong + 2; END_IF;
        SPLIT_DT(IN := LINT_TO_DT(-9223372036854775808), YEAR => year, MONTH => month, DAY => day, MINUTE => minute);
        IF year <> 1677 OR month <> 9 OR day <> 21 OR minute <> 12 THEN wrong := wrong + 4; END_IF;
        SPLIT_DATE(IN := LINT_TO_DATE(-1), YEAR => year, MONTH => month, DAY => day);
        IF year <> 1969 OR month <> 12 OR day <> 31 THEN wrong := wrong + 8; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn an_exponent_that_a_real_does_not_hold_keeps_its_value() {
    let declarations = "PROGRAM Main
        VAR minus, r : REAL := -1.0; d : DINT := 16777217; u : UDINT := 16777217; l : LINT := -16777217; w : ULINT := 16777217; END_VAR";
    let statements = "
        r := (-1.0) ** d; IF r <> REAL#-1.0 THEN wrong := wrong + 1; END_IF;
        r := minus ** d; IF r <> REAL#-1.0 THEN wrong := wrong + 2; END_IF;
        r := EXPT(minus, u); IF r <> REAL#-1.0 THEN wrong := wrong + 4; END_IF;
        r := minus ** l; IF r <> REAL#-1.0 THEN wrong := wrong + 8; END_IF;
        r := minus ** w; IF r <> REAL#-1.0 THEN wrong := wrong + 16; END_IF;
        r := minus ** 16777217; IF r <> REAL#-1.0 THEN wrong := wrong + 32; END_IF;
        d := 3; r := 2.0 ** d; IF r <> REAL#8.0 THEN wrong := wrong + 64; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn a_time_of_day_stays_within_its_day() {
    let declarations = "PROGRAM Main
        VAR t : TOD := TOD#23:00:00; lt : LTOD := LTOD#01:00:00; h : TIME := T#2h; far : TIME := T#106751d23h; END_VAR";
    let statements = "
        IF t + h <> TOD#01:00:00 OR TOD#23:00:00 + T#2h <> TOD#01:00:00 THEN wrong := wrong + 1; END_IF;
        IF lt - h <> LTOD#23:00:00 OR TOD#01:00:00 - T#2h <> TOD#23:00:00 THEN wrong := wrong + 2; END_IF;
        IF t - h <> TOD#21:00:00 OR lt + h <> LTOD#03:00:00 THEN wrong := wrong + 4; END_IF;
        IF t + far <> TOD#22:00:00 OR lt - far <> LTOD#02:00:00 THEN wrong := wrong + 8; END_IF;
        IF t + T#24h <> t OR t - T#48h <> t OR t + -h <> TOD#21:00:00 THEN wrong := wrong + 16; END_IF;
        IF ADD_TOD_TIME(t, h) <> TOD#01:00:00 OR SUB_TOD_TIME(t, T#24h) <> t THEN wrong := wrong + 32; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn a_constant_is_rounded_to_a_real_once() {
    // Between two values of REAL, a little above the middle, which an LREAL does not tell from the middle.
    let declarations = "
        PROGRAM Main
        VAR l : LINT := 16#4000_0040_0000_0001; u : ULINT := 16#8000_0080_0000_0001; r : REAL; END_VAR";
    let statements = "
        r := LINT_TO_REAL(l); IF r <> LINT_TO_REAL(16#4000_0040_0000_0001) THEN wrong := wrong + 1; END_IF;
        r := ULINT_TO_REAL(u); IF r <> ULINT_TO_REAL(16#8000_0080_0000_0001) THEN wrong := wrong + 2; END_IF;
        r := LINT_TO_REAL(l); IF r <> REAL#4611686293305294849 THEN wrong := wrong + 4; END_IF;
        r := 4611686293305294849; IF r <> LINT_TO_REAL(l) THEN wrong := wrong + 8; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}
