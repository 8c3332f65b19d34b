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
