//! What statements do, on the interpreter and as machine code: each check of a program adds to `wrong` what it is known by.

use crate::oracle::Job;
use crate::program::{CONFIGURATION, Twice, compile};
use takt_st::hir::{Program, TrapKind};

pub fn program(declarations: &str, statements: &str) -> Program {
    let source = format!(
        "{declarations}\nVAR wrong AT %MD0 : DINT; END_VAR\n{statements}\nEND_PROGRAM\n{CONFIGURATION}"
    );
    compile("language", &source)
}

/// The sum of the failed checks of a program whose declarations and statements these are.
pub fn wrong(declarations: &str, statements: &str) -> i32 {
    let program = program(declarations, statements);
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

#[test]
fn characters_of_strings_are_read_and_assigned() {
    let declarations = "
        TYPE Line : STRUCT number : INT; text : STRING[5]; END_STRUCT; END_TYPE
        VAR_GLOBAL shared : STRING := 'shared'; END_VAR
        FUNCTION Shout : INT
            VAR_IN_OUT text : STRING; END_VAR
            VAR i : INT; END_VAR
            FOR i := 1 TO LEN(text) DO
                IF text[i] >= 'a' AND text[i] <= 'z' THEN
                    text[i] := BYTE_TO_CHAR(USINT_TO_BYTE(BYTE_TO_USINT(CHAR_TO_BYTE(text[i])) - 32));
                    Shout := Shout + 1;
                END_IF;
            END_FOR;
        END_FUNCTION
        FUNCTION Shortened : INT
            shared := 'sh';
            Shortened := 2;
        END_FUNCTION
        FUNCTION Taken
            VAR_OUTPUT c : CHAR; END_VAR
            c := '!';
        END_FUNCTION
        PROGRAM Main
        VAR
            s : STRING := 'text'; ws : WSTRING := \"wide$0100\"; w : WCHAR; c : CHAR; i : INT; k : ULINT := 2;
            lines : ARRAY[0..2] OF Line := [3((text := 'abc'))]; short : ARRAY[1..2] OF STRING[3] := ['abc', 'de'];
            r : REF_TO STRING; quoted : STRING := 'q';
        END_VAR";
    let statements = "
        c := s[1]; IF c <> 't' OR s[4] <> CHAR#'t' OR s[LEN(s)] <> 't' THEN wrong := wrong + 1; END_IF;
        s[2] := 'o'; s[k + 1] := c; IF s <> 'tott' THEN wrong := wrong + 2; END_IF;
        w := ws[5]; IF w <> WCHAR#\"$0100\" OR WCHAR_TO_WORD(ws[5]) <> 16#100 THEN wrong := wrong + 4; END_IF;
        ws[1] := \"W\"; ws[5] := ws[2]; IF ws <> \"Widei\" THEN wrong := wrong + 8; END_IF;
        FOR i := 0 TO 2 DO lines[i].text[i + 1] := '-'; END_FOR;
        IF lines[0].text <> '-bc' OR lines[1].text <> 'a-c' OR lines[2].text <> 'ab-' THEN wrong := wrong + 16; END_IF;
        IF short[1][3] <> 'c' OR short[2][2] <> 'e' THEN wrong := wrong + 32; END_IF;
        r := REF(shared); r^[1] := 'S'; IF shared[1] <> 'S' OR r^[2] <> 'h' THEN wrong := wrong + 64; END_IF;
        IF Shout(s) <> 4 OR s <> 'TOTT' THEN wrong := wrong + 128; END_IF;
        IF shared[Shortened()] <> 'h' THEN wrong := wrong + 256; END_IF;
        s[3] := CHAR#'$00'; IF s <> 'TO' OR LEN(s) <> 2 THEN wrong := wrong + 512; END_IF;
        Taken(c => s[1]); IF s <> '!O' THEN wrong := wrong + 1024; END_IF;
        IF CONCAT(s[2], s[1]) <> 'O!' THEN wrong := wrong + 2048; END_IF;
        quoted := s[1]; IF quoted <> '!' THEN wrong := wrong + 4096; END_IF;
        s[1] := s[2]; s[2] := SEL(i > 0, s[2], 'x'); s[1] := SEL(i = 0, 'y', 'z');
        IF s <> 'zx' AND i = 0 OR s <> 'yx' AND i <> 0 THEN wrong := wrong + 8192; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn a_position_outside_of_a_string_is_a_trap() {
    let declarations = "
        VAR_GLOBAL shared : STRING := 'shared'; END_VAR
        FUNCTION Shortened : INT
            shared := 'sh';
            Shortened := 3;
        END_FUNCTION
        PROGRAM Main
        VAR s : STRING[5] := 'abc'; ws : WSTRING := \"abc\"; i : INT := 4; c : CHAR; w : WCHAR; none : STRING;
            big : ULINT := 16#8000_0000_0000_0000; least : LINT := LINT#-9223372036854775808; END_VAR";
    let statements = [
        "c := s[i];",
        "c := s[i - 4];",
        "c := s[i - 5];",
        "c := s[big];",
        "c := s[least];",
        "s[i] := 'x';",
        "s[4] := 'x';",
        "c := none[1];",
        "w := ws[i];",
        "ws[i - 4] := \"x\";",
        "c := shared[Shortened()];",
    ];
    for statement in statements {
        let program = program(declarations, statement);
        let trap = Twice::start(&program).trap(Job::default());
        assert_eq!(trap.kind, TrapKind::Bounds, "{statement}");
    }
}

#[test]
fn arrays_of_any_size_are_given_and_returned() {
    let declarations = "
        FUNCTION Sum : DINT
            VAR_INPUT data : ARRAY[*] OF INT; END_VAR
            VAR i : DINT; END_VAR
            FOR i := LOWER_BOUND(data, 1) TO UPPER_BOUND(data, 1) DO Sum := Sum + data[i]; END_FOR;
        END_FUNCTION
        FUNCTION Twice : DINT
            VAR_INPUT factor : DINT; data : ARRAY[*] OF INT; END_VAR
            Twice := factor * Sum(data);
        END_FUNCTION
        FUNCTION Numbers
            VAR_INPUT first : INT; END_VAR
            VAR_OUTPUT data : ARRAY[*] OF INT; last : INT; END_VAR
            VAR i : DINT; END_VAR
            last := first;
            FOR i := LOWER_BOUND(data, 1) TO UPPER_BOUND(data, 1) DO data[i] := last; last := last + 1; END_FOR;
        END_FUNCTION
        FUNCTION Local : DINT
            VAR own : ARRAY[-1..1] OF INT; last : INT; END_VAR
            Numbers(first := 5, data => own, last => last);
            Local := Sum(own) * 10 + last;
        END_FUNCTION
        PROGRAM Main
        VAR CONSTANT k : ARRAY[1..2] OF INT := [100, 200]; END_VAR
        VAR a : ARRAY[0..3] OF INT; rows : ARRAY[0..1] OF ARRAY[5..6] OF INT; n : INT; END_VAR";
    let statements = "
        Numbers(first := 1, data => a, last => n); IF n <> 5 OR Sum(a) <> 10 THEN wrong := wrong + 1; END_IF;
        IF Twice(2, a) <> 20 OR Twice(data := k, factor := 3) <> 900 THEN wrong := wrong + 2; END_IF;
        Numbers(first := 7, data => rows[1]); IF rows[1][5] <> 7 OR rows[1][6] <> 8 OR Sum(rows[0]) <> 0
            THEN wrong := wrong + 4; END_IF;
        IF Local() <> 188 THEN wrong := wrong + 8; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn what_an_initial_value_leaves_out_is_as_the_type_has_it() {
    let declarations = "
        TYPE
            Percent : INT := 20;
            Mode : (Stop, Go, Jog) := Go;
            Axis : STRUCT place : INT := 1; name : STRING[8] := 'axis'; limits : ARRAY[0..1] OF INT := [3, 4]; END_STRUCT
            Slow : Axis := (place := 9);
            Line : STRUCT
                axes : ARRAY[1..3] OF Axis := [(place := 2), 2((name := 'two'))];
                last : Axis := (name := 'last', limits := [5]);
            END_STRUCT
            Three : ARRAY[1..3] OF INT := [1, 2, 3];
        END_TYPE
        PROGRAM Main
        VAR
            p : ARRAY[1..3] OF Percent := [1]; m : ARRAY[0..1, 0..2] OF Mode := [Jog, Stop];
            a : Slow := (name := 'a'); b : ARRAY[1..2] OF Slow := [(name := 'b')];
            l : Line := (axes := [(name := 'x')], last := (place := 7)); t : Three := [2(8)];
            r : ARRAY[1..2] OF Three := [2([9])]; empty : ARRAY[1..2] OF Slow := [2()];
        END_VAR";
    let statements = "
        IF p[1] <> 1 OR p[2] <> 20 OR p[3] <> 20 THEN wrong := wrong + 1; END_IF;
        IF m[0, 0] <> Jog OR m[0, 1] <> Stop OR m[0, 2] <> Go OR m[1, 2] <> Go THEN wrong := wrong + 2; END_IF;
        IF a.place <> 9 OR a.name <> 'a' OR a.limits[1] <> 4 THEN wrong := wrong + 4; END_IF;
        IF b[1].place <> 9 OR b[1].name <> 'b' OR b[2].place <> 9 OR b[2].name <> 'axis' THEN wrong := wrong + 8; END_IF;
        IF l.axes[1].place <> 2 OR l.axes[1].name <> 'x' OR l.axes[3].name <> 'two' OR l.axes[3].place <> 1
            THEN wrong := wrong + 16; END_IF;
        IF l.last.place <> 7 OR l.last.name <> 'last' OR l.last.limits[0] <> 5 OR l.last.limits[1] <> 4
            THEN wrong := wrong + 32; END_IF;
        IF t[1] <> 8 OR t[2] <> 8 OR t[3] <> 3 OR r[2][1] <> 9 OR r[2][3] <> 3 THEN wrong := wrong + 64; END_IF;
        IF empty[1].place <> 9 OR empty[2].place <> 9 THEN wrong := wrong + 128; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn function_blocks_work_on_arrays_of_any_size() {
    let declarations = "
        FUNCTION Sum : DINT
            VAR_INPUT data : ARRAY[*] OF INT; END_VAR
            VAR i : DINT; END_VAR
            FOR i := LOWER_BOUND(data, 1) TO UPPER_BOUND(data, 1) DO Sum := Sum + data[i]; END_FOR;
        END_FUNCTION
        FUNCTION_BLOCK Fill
            VAR_INPUT stride : INT := 1; END_VAR
            VAR_IN_OUT data : ARRAY[*] OF INT; calls : INT; END_VAR
            VAR next : INT; i : DINT; END_VAR
            VAR_OUTPUT total : DINT; END_VAR
            FOR i := LOWER_BOUND(data, 1) TO UPPER_BOUND(data, 1) DO next := next + stride; data[i] := next; END_FOR;
            calls := calls + 1;
            total := Sum(data);
        END_FUNCTION_BLOCK
        FUNCTION_BLOCK More
            VAR_IN_OUT data : ARRAY[*] OF INT; END_VAR
            data[0] := data[0] + 4;
        END_FUNCTION_BLOCK
        FUNCTION_BLOCK Outer
            VAR_IN_OUT table : ARRAY[*, *] OF INT; row : ARRAY[*] OF INT; END_VAR
            VAR fill : Fill; calls : INT; END_VAR
            fill(stride := 2, data := row, calls := calls);
            table[UPPER_BOUND(table, 1), LOWER_BOUND(table, 2)] := row[LOWER_BOUND(row, 1)] + calls;
        END_FUNCTION_BLOCK
        PROGRAM Main
        VAR a : ARRAY[0..3] OF INT; b : ARRAY[-2..-1] OF INT; rows : ARRAY[0..1] OF ARRAY[5..6] OF INT; END_VAR
        VAR table : ARRAY[1..2, 3..4] OF INT; fill : Fill; outer : ARRAY[0..1] OF Outer; calls, n, sum : INT; more : More; END_VAR";
    let statements = "
        fill(data := a, calls := calls); IF a[3] <> 4 OR fill.total <> 10 THEN wrong := wrong + 1; END_IF;
        fill(data := b, calls := calls); IF b[-1] <> 6 OR fill.total <> 11 THEN wrong := wrong + 2; END_IF;
        fill(data := rows[1], calls := calls); IF rows[1][6] <> 8 OR rows[0][6] <> 0 OR calls <> 3
            THEN wrong := wrong + 4; END_IF;
        outer[1](table := table, row := a); outer[1](row := b, table := table);
        IF a[3] <> 8 OR b[-2] <> 10 OR table[2, 3] <> 12 OR table[1, 3] <> 0 THEN wrong := wrong + 8; END_IF;
        a[0] := 0;
        FOR n := 1 TO 5 DO more(data := a); sum := sum + a[0]; a[0] := a[0] + 1; END_FOR;
        IF sum <> 70 OR a[0] <> 25 THEN wrong := wrong + 16; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn a_function_block_does_not_leave_an_array_of_any_size() {
    let declarations = "
        FUNCTION_BLOCK Mark
            VAR_INPUT i : DINT; END_VAR
            VAR_IN_OUT data : ARRAY[*] OF INT; END_VAR
            data[i] := 1;
        END_FUNCTION_BLOCK
        PROGRAM Main
        VAR long : ARRAY[0..9] OF INT; short : ARRAY[0..1] OF INT; mark : Mark; END_VAR";
    for statement in ["mark(i := 2, data := short);", "mark(i := -1, data := long);"] {
        // The bounds are those of this call, not of the one before.
        let program = program(declarations, &format!("mark(i := 1, data := long); {statement}"));
        let trap = Twice::start(&program).trap(Job::default());
        assert_eq!(trap.kind, TrapKind::Bounds, "{statement}");
    }
}

#[test]
fn an_input_with_an_edge_sees_in_its_first_call_what_the_blocks_see() {
    let declarations = "
        FUNCTION_BLOCK Edges
            VAR_INPUT rise : BOOL R_EDGE; fall : BOOL F_EDGE; END_VAR
            VAR_OUTPUT rose, fell : BOOL; END_VAR
            rose := rise; fell := fall;
        END_FUNCTION_BLOCK
        PROGRAM Main
        VAR edges : ARRAY[0..1] OF Edges; rises : ARRAY[0..1] OF R_TRIG; falls : ARRAY[0..1] OF F_TRIG; k, n : INT; on : BOOL; END_VAR";
    let statements = "
        FOR k := 0 TO 1 DO
            FOR n := 0 TO 4 DO
                on := (k = 1) = (n MOD 3 = 0);
                edges[k](rise := on, fall := on); rises[k](CLK := on); falls[k](CLK := on);
                IF edges[k].rose <> rises[k].Q OR edges[k].fell <> falls[k].Q THEN wrong := wrong + 1; END_IF;
                IF n = 0 AND (edges[k].rose <> on OR edges[k].fell = on) THEN wrong := wrong + 100; END_IF;
            END_FOR;
        END_FOR;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn character_0_makes_no_text() {
    let declarations = "
        VAR_GLOBAL trace : STRING; END_VAR
        PROGRAM Main
        VAR nothing : CHAR := '$00'; nothing_wide : WCHAR := \"$0000\"; s : STRING := 'ab'; w : WSTRING; END_VAR";
    let statements = "
        s := CONCAT(s, nothing, 'c'); IF s <> 'abc' OR LEN(s) <> 3 THEN wrong := wrong + 1; END_IF;
        s := CHAR_TO_STRING(nothing); IF LEN(s) <> 0 THEN wrong := wrong + 2; END_IF;
        IF LEN(CHAR_TO_STRING(nothing)) <> 0 OR CHAR_TO_STRING(nothing) <> '' THEN wrong := wrong + 4; END_IF;
        w := CONCAT(nothing_wide, \"x\"); IF w <> \"x\" THEN wrong := wrong + 8; END_IF;
        trace := s;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn a_loop_may_make_as_many_rounds_as_its_budget_has() {
    let rounds = |loops: &str| {
        let mut program = program("PROGRAM Main VAR n, k : DINT; END_VAR", loops);
        program.loop_budget = 5;
        program
    };
    let most = rounds(
        "WHILE n < 5 DO n := n + 1; END_WHILE;
        REPEAT n := n - 1; UNTIL n = 0 END_REPEAT;
        k := 5; FOR n := 1 TO k DO wrong := wrong + 1; END_FOR; wrong := wrong - 5;",
    );
    let mut machine = Twice::start(&most);
    machine.run(Job::default());
    assert_eq!(machine.marker(0), 0);
    drop(machine);
    for more in [
        "WHILE n < 6 DO n := n + 1; END_WHILE;",
        "REPEAT n := n + 1; UNTIL n = 6 END_REPEAT;",
        "k := 6; FOR n := 1 TO k DO wrong := wrong + 1; END_FOR;",
    ] {
        let more = rounds(more);
        assert_eq!(Twice::start(&more).trap(Job::default()).kind, TrapKind::LoopBudget);
    }
}

#[test]
fn a_variable_that_is_not_retained_begins_anew_in_an_instance_that_is() {
    let declarations = "
        FUNCTION_BLOCK Inner
            VAR NON_RETAIN jobs : INT; rows : ARRAY[0..2] OF STRING[4]; END_VAR
            VAR kept : INT; END_VAR
            VAR RETAIN own : INT; END_VAR
            VAR_OUTPUT code : INT; END_VAR
            jobs := jobs + 1; kept := kept + 1; own := own + 1;
            code := jobs * 100 + kept * 10 + own;
            IF rows[2] <> '' AND jobs = 1 THEN code := -1; END_IF;
            rows[2] := 'text';
        END_FUNCTION_BLOCK
        FUNCTION_BLOCK Outer
            VAR all : ARRAY[1..2] OF Inner; END_VAR
            VAR NON_RETAIN short : Inner; END_VAR
            VAR_OUTPUT a, b : INT; END_VAR
            all[2](code => a); short(code => b);
        END_FUNCTION_BLOCK
        PROGRAM Main
        VAR RETAIN outer : Outer; END_VAR
        VAR a AT %MD1 : DINT; b AT %MD2 : DINT; END_VAR";
    let program = program(declarations, "outer(); a := outer.a; b := outer.b;");
    let mut machine = Twice::start(&program);
    machine.run(Job::default());
    machine.run(Job::default());
    assert_eq!((machine.marker(1), machine.marker(2)), (222, 222));
    machine.restart();
    machine.run(Job::default());
    assert_eq!((machine.marker(1), machine.marker(2)), (133, 113));
}
