//! What statements do, on the interpreter and as machine code: each check of a program adds to `wrong` what it is known by.

use crate::oracle::Job;
use crate::program::{CONFIGURATION, Twice, compile};

/// The sum of the failed checks of a program whose declarations and statements these are.
fn wrong(declarations: &str, statements: &str) -> i32 {
    let source = format!(
        "{declarations}\nVAR wrong AT %MD0 : DINT; END_VAR\n{statements}\nEND_PROGRAM\n{CONFIGURATION}"
    );
    let program = compile("language", &source);
    let mut machine = Twice::start(&program);
    machine.run(Job::default());
    machine.marker(0)
}

#[test]
fn a_literal_with_a_point_is_a_real_where_one_is_needed() {
    let declarations = "PROGRAM Main
        VAR i : INT := 3; us : USINT := 200; r, tenth : REAL; b : BOOL := TRUE; END_VAR";
    let statements = "
        tenth := 0.1;
        r := i * 0.1; IF r <> i * tenth THEN wrong := wrong + 1; END_IF;
        r := i / 2.0; IF r <> REAL#1.5 THEN wrong := wrong + 2; END_IF;
        r := -i * 0.5 + us; IF r <> REAL#198.5 THEN wrong := wrong + 4; END_IF;
        r := LIMIT(0.0, us * 0.75, 100.0); IF r <> REAL#100.0 THEN wrong := wrong + 8; END_IF;
        r := MAX(i, 3.5); IF r <> REAL#3.5 THEN wrong := wrong + 16; END_IF;
        r := SEL(b, 0.5, i); IF r <> REAL#3.0 THEN wrong := wrong + 32; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn numbers_alone_are_of_the_bit_string_that_is_needed() {
    let declarations =
        "PROGRAM Main VAR w : WORD := 16#F0; d : DWORD; y : BYTE; i : INT := 1; END_VAR";
    let statements = "
        w := NOT 16#0F; IF w <> 16#FFF0 THEN wrong := wrong + 1; END_IF;
        d := NOT 16#0F; IF d <> 16#FFFF_FFF0 THEN wrong := wrong + 2; END_IF;
        w := SHL(1, 15); IF w <> 16#8000 THEN wrong := wrong + 4; END_IF;
        y := ROL(16#81, 1); IF y <> 16#03 THEN wrong := wrong + 8; END_IF;
        w := 16#FF AND 16#3C XOR 16#4; IF w <> 16#38 THEN wrong := wrong + 16; END_IF;
        w := MAX(w, 16#8000); IF w <> 16#8000 THEN wrong := wrong + 32; END_IF;
        w := MUX(i, 16#1, w, 16#F); IF w <> 16#8000 THEN wrong := wrong + 64; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn arrays_and_structures_are_selected() {
    let declarations = "
        TYPE Pair : STRUCT a : INT; s : STRING[5]; END_STRUCT; END_TYPE
        VAR_GLOBAL first : Pair := (a := 1, s := 'one'); second : Pair := (a := 2, s := 'two'); END_VAR
        FUNCTION Changing : Pair
            first.a := 100;
            Changing := second;
            Changing.a := 3;
        END_FUNCTION
        FUNCTION Sum : INT
            VAR_INPUT row : ARRAY[0..39] OF INT; END_VAR
            Sum := row[0] + row[39];
        END_FUNCTION
        PROGRAM Main
        VAR p : Pair; a, b, c : ARRAY[0..39] OF INT; yes : BOOL := TRUE; k : INT := 1; END_VAR";
    let statements = "
        a[0] := 1; a[39] := 2; b[0] := 10; b[39] := 20;
        p := SEL(yes, first, second); IF p.a <> 2 OR p.s <> 'two' THEN wrong := wrong + 1; END_IF;
        p := SEL(NOT yes, first, second); IF p.a <> 1 THEN wrong := wrong + 2; END_IF;
        p := SEL(NOT yes, first, Changing()); IF p.a <> 1 THEN wrong := wrong + 4; END_IF;
        p := SEL(yes, first, Changing()); IF p.a <> 3 OR p.s <> 'two' THEN wrong := wrong + 8; END_IF;
        c := MUX(k, a, b, a); IF Sum(c) <> 30 THEN wrong := wrong + 16; END_IF;
        IF Sum(SEL(yes, b, a)) <> 3 THEN wrong := wrong + 32; END_IF;
        c := MOVE(a); IF Sum(c) <> 3 THEN wrong := wrong + 64; END_IF;
        k := 9; a := MUX(k, c, b, a); IF Sum(a) <> 3 THEN wrong := wrong + 128; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}
