//! Calls: when outputs and instances are evaluated. On the interpreter and as machine code, as in `language`.

use crate::language::wrong;

const FUNCTIONS: &str = "
    FUNCTION Both : INT
        VAR_INPUT a : INT; END_VAR
        VAR_OUTPUT x : INT; END_VAR
        x := a + 1; Both := a;
    END_FUNCTION
    FUNCTION Yes : BOOL
        VAR_INPUT a : INT; END_VAR
        VAR_OUTPUT q : BOOL; END_VAR
        q := a = 0; Yes := TRUE;
    END_FUNCTION";

#[test]
fn an_output_of_another_type_is_assigned_only_if_its_function_is_called() {
    let declarations = format!(
        "{FUNCTIONS}
        PROGRAM Main
        VAR y : INT := 3; d : DINT := 55; e, on : BOOL; END_VAR"
    );
    let statements = "
        y := Both(EN := FALSE, a := 1, x => d); IF d <> 55 OR y <> 3 THEN wrong := wrong + 1; END_IF;
        Both(EN := e, a := 1, x => d, ENO => on); IF d <> 55 OR on THEN wrong := wrong + 2; END_IF;
        y := Both(EN := TRUE, a := 1, x => d, ENO => on); IF d <> 2 OR y <> 1 OR NOT on THEN wrong := wrong + 4; END_IF;
        e := Yes(EN := FALSE, a := 1, NOT q => on); IF NOT on OR e THEN wrong := wrong + 8; END_IF;
        on := FALSE;
        e := Yes(a := 1, NOT q => on); IF NOT on OR NOT e THEN wrong := wrong + 16; END_IF;";
    assert_eq!(wrong(&declarations, statements), 0);
}

#[test]
fn en_of_one_of_several_functions_takes_the_one_that_fits() {
    let declarations = "PROGRAM Main VAR t : TIME; ok, on : BOOL; w : WORD; END_VAR";
    let statements = "
        t := DIV_TIME(EN := TRUE, IN1 := T#10ms, IN2 := 4.0, ENO => on);
        IF t <> T#2500us OR NOT on THEN wrong := wrong + 1; END_IF;
        t := DIV_TIME(EN := FALSE, IN1 := T#10ms, IN2 := 2, ENO => on);
        IF t <> T#2500us OR on THEN wrong := wrong + 2; END_IF;
        w := TO_BIG_ENDIAN(EN := TRUE, IN := WORD#16#1234);
        IF w <> WORD#16#3412 THEN wrong := wrong + 4; END_IF;
        ok := IS_VALID_BCD(EN := TRUE, IN := WORD#16#A000);
        IF ok THEN wrong := wrong + 8; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn an_output_of_another_type_comes_before_the_assignment_of_the_value() {
    let declarations = format!(
        "{FUNCTIONS}
        PROGRAM Main
        VAR row : ARRAY[0..3] OF DINT; d : DINT := 3; i : INT; END_VAR"
    );
    // As outputs of the same type have it: places of outputs before the call, that on the left behind it.
    let statements = "
        row[d] := Both(a := 1, x => d); IF d <> 2 OR row[2] <> 1 OR row[3] <> 0 THEN wrong := wrong + 1; END_IF;
        d := (Both(a := 7, x => d)); IF d <> 7 THEN wrong := wrong + 2; END_IF;
        i := Both(a := 0, x => row[i]); IF row[0] <> 1 OR row[1] <> 0 THEN wrong := wrong + 4; END_IF;
        i := 3; i := Both(a := 0, x => row[i]); IF row[3] <> 1 OR row[0] <> 1 THEN wrong := wrong + 8; END_IF;";
    assert_eq!(wrong(&declarations, statements), 0);
}

#[test]
fn a_call_of_an_instance_evaluates_its_index_once() {
    let declarations = "
        FUNCTION_BLOCK Node
            VAR_INPUT id : INT; value : INT; END_VAR
            VAR_OUTPUT next : INT; doubled : INT; END_VAR
            next := id + 1; doubled := 2 * value;
        END_FUNCTION_BLOCK
        FUNCTION_BLOCK Group
            VAR_INPUT first : INT; END_VAR
            VAR_IN_OUT all : ARRAY[0..3] OF Node; END_VAR
            VAR place : INT; END_VAR
            place := first;
            all[place](id := place + 1, value := 4, next => place);
            place := first;
            all[place](id := place, value := all[first].doubled, doubled => place);
        END_FUNCTION_BLOCK
        VAR_GLOBAL calls : INT; END_VAR
        FUNCTION Next : INT
            calls := calls + 1;
            Next := calls;
        END_FUNCTION
        PROGRAM Main
        VAR n : ARRAY[0..3] OF Node; rows : ARRAY[0..1] OF ARRAY[1..2] OF Node; i, j, v : INT; r : REF_TO Node;
            group : Group; END_VAR";
    let statements = "
        n[i](id := 1, value := 5, next => i, doubled => v); IF i <> 2 OR v <> 10 THEN wrong := wrong + 1; END_IF;
        n[Next()](id := 1, value := 2);
        IF calls <> 1 OR n[1].doubled <> 4 OR n[1].next <> 2 THEN wrong := wrong + 2; END_IF;
        i := 1; j := 2;
        rows[i, j](id := Next(), value := 3, next => j, doubled => i); IF i <> 6 OR j <> 3 OR calls <> 2
            THEN wrong := wrong + 4; END_IF;
        i := 2; n[i].value := 0; n[3].value := 0;
        n[i](EN := FALSE, id := 1, value := 9, next => i); IF i <> 2 OR n[2].value <> 0 THEN wrong := wrong + 8; END_IF;
        FOR i := 0 TO 3 DO n[i](id := i, value := i + 1); END_FOR;
        FOR i := 0 TO 3 DO
            IF n[i].doubled <> 2 * i + 2 OR n[i].next <> i + 1 THEN wrong := wrong + 16; END_IF;
        END_FOR;
        r := REF(n[3]); r^(id := 7, value := 8, next => v); IF v <> 8 OR n[3].doubled <> 16 THEN wrong := wrong + 32; END_IF;
        group(first := 0, all := n); IF n[0].doubled <> 16 OR n[0].id <> 0 OR n[1].id <> 1 THEN wrong := wrong + 64; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn limit_evaluates_its_arguments_in_their_order() {
    let declarations = "
        VAR_GLOBAL trace : DINT; END_VAR
        FUNCTION Note : INT
            VAR_INPUT digit : INT; END_VAR
            trace := trace * 10 + digit; Note := digit;
        END_FUNCTION
        FUNCTION Noted : LREAL
            VAR_INPUT digit : INT; END_VAR
            Noted := INT_TO_LREAL(Note(digit));
        END_FUNCTION
        PROGRAM Main VAR n : INT; r : LREAL; END_VAR";
    let statements = "
        n := LIMIT(Note(1), Note(2), Note(3)); IF trace <> 123 OR n <> 2 THEN wrong := wrong + 1; END_IF;
        trace := 0;
        n := LIMIT(MX := Note(3), IN := Note(9), MN := Note(1)); IF trace <> 193 OR n <> 3 THEN wrong := wrong + 2; END_IF;
        trace := 0;
        r := LIMIT(Noted(1), Noted(2), Noted(3)); IF trace <> 123 OR r <> 2.0 THEN wrong := wrong + 4; END_IF;
        trace := 0;
        r := LIMIT(MX := Noted(3), IN := Noted(9), MN := Noted(1)); IF trace <> 193 OR r <> 3.0 THEN wrong := wrong + 8; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}

#[test]
fn the_variable_of_an_output_is_found_before_the_block_runs() {
    let declarations = "
        VAR_GLOBAL next : INT := 1; END_VAR
        FUNCTION_BLOCK Mover
            VAR_INPUT far : INT; END_VAR
            VAR_OUTPUT was, bit : INT; END_VAR
            was := next; next := next + far;
        END_FUNCTION_BLOCK
        PROGRAM Main
        VAR mover : Mover; row : ARRAY[0..5] OF INT; n : INT; r : REF_TO INT; END_VAR";
    let statements = "
        mover(far := 2, was => row[next]); IF row[1] <> 1 OR row[3] <> 0 THEN wrong := wrong + 1; END_IF;
        next := 0; mover(far := 4, was => next, bit => row[next + 2]);
        IF next <> 0 OR row[2] <> 0 THEN wrong := wrong + 2; END_IF;
        next := 2; mover(far := 1, was => row[next], bit => row[next + 1]);
        IF row[2] <> 2 OR row[3] <> 0 OR row[4] <> 0 THEN wrong := wrong + 4; END_IF;
        r := REF(n); mover(far := 0, was => r^); IF n <> 3 THEN wrong := wrong + 8; END_IF;";
    assert_eq!(wrong(declarations, statements), 0);
}
