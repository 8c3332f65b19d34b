//! What the standard leaves to a compiler, as docs/st.md tells it: each case is a TEST that runs as machine code.

mod common;

use common::Folder;

const MAIN: &str = "\
FUNCTION note : INT
VAR_INPUT digit : INT; END_VAR
trace := trace * 10 + digit;
note := digit;
END_FUNCTION
FUNCTION says : BOOL
VAR_INPUT digit : INT; answer : BOOL; END_VAR
trace := trace * 10 + digit;
says := answer;
END_FUNCTION
FUNCTION less : INT
VAR_INPUT a : INT; b : INT; END_VAR
less := a - b;
END_FUNCTION
FUNCTION_BLOCK pair
VAR_INPUT a : INT; b : INT; END_VAR
VAR_OUTPUT sum : INT; END_VAR
sum := a + b;
trace := trace * 10 + 9;
END_FUNCTION_BLOCK
VAR_GLOBAL trace : DINT; END_VAR
PROGRAM Main
VAR first : pair; END_VAR
first(a := less(note(1), 1), b := 2);
END_PROGRAM
CONFIGURATION c
TASK t (INTERVAL := T#1ms, PRIORITY := 1);
PROGRAM p WITH t : Main;
END_CONFIGURATION
";

const TESTS: &str = "\
TEST 'operands'
VAR x : INT; END_VAR
x := note(1) + note(2) * note(3);
ASSERT(trace = 123);
END_TEST
TEST 'an assignment'
VAR row : ARRAY[0..9] OF INT; END_VAR
row[note(1)] := note(2);
ASSERT(trace = 21);
END_TEST
TEST 'arguments of a function'
VAR x : INT; END_VAR
x := less(b := note(1), a := note(2));
ASSERT(trace = 21);
END_TEST
TEST 'inputs of a block'
VAR block : pair; END_VAR
block(b := note(1), a := note(2));
ASSERT(trace = 219);
END_TEST
TEST 'AND and OR'
VAR b : BOOL; END_VAR
b := says(1, FALSE) AND says(2, TRUE);
b := says(3, TRUE) OR says(4, TRUE);
b := says(5, FALSE) AND_THEN says(6, TRUE);
b := says(7, TRUE) OR_ELSE says(8, TRUE);
ASSERT(trace = 123457);
END_TEST
TEST 'an integer that overflows'
VAR i : INT := 32767; END_VAR
i := i + 1;
ASSERT(i = -32768);
ASSERT(-i = -32768);
ASSERT(ABS(i) = -32768);
END_TEST
TEST 'integer division'
VAR i : INT := -7; d : DINT := -2147483648; END_VAR
ASSERT(i / 2 = -3);
ASSERT(i MOD 2 = -1);
ASSERT(7 MOD (i + 5) = 1);
ASSERT(d / -1 = -2147483648);
ASSERT(d MOD -1 = 0);
END_TEST
TEST 'division of LREAL, and NaN'
VAR zero, one, nan : LREAL; END_VAR
zero := 0.0; one := 1.0;
ASSERT(one / zero > 1.7E308);
ASSERT(-one / zero < -1.7E308);
nan := zero / zero;
ASSERT(nan <> nan);
ASSERT(NOT (nan = nan));
ASSERT(NOT (nan < one) AND NOT (nan >= one));
END_TEST
TEST 'REAL to an integer'
VAR zero, nan, half : LREAL; large : REAL := 1.0E20; END_VAR
zero := 0.0; half := 2.5;
nan := zero / zero;
ASSERT(LREAL_TO_INT(half) = 2);
ASSERT(LREAL_TO_INT(half + 1.0) = 4);
ASSERT(REAL_TO_INT(large) = 32767);
ASSERT(REAL_TO_INT(-large) = -32768);
ASSERT(REAL_TO_USINT(-large) = USINT#0);
ASSERT(REAL_TO_UDINT(large) = UDINT#4294967295);
ASSERT(REAL_TO_LINT(large) = 9223372036854775807);
ASSERT(LREAL_TO_INT(nan) = 0);
ASSERT(LREAL_TO_LINT(nan) = 0);
ASSERT(LREAL_TRUNC_INT(half) = 2);
ASSERT(LREAL_TRUNC_INT(nan) = 0);
ASSERT(REAL_TRUNC_INT(large) = 32767);
END_TEST
TEST 'an integer to a smaller one'
VAR i : INT := 300; minus : INT := -1; END_VAR
ASSERT(INT_TO_SINT(i) = 44);
ASSERT(INT_TO_UINT(minus) = UINT#65535);
END_TEST
TEST 'LREAL to REAL'
VAR large : LREAL := 1.0E300; END_VAR
ASSERT(LREAL_TO_REAL(large) > 3.4E38);
END_TEST
TEST 'a bit string to BOOL'
VAR w : WORD := 2; END_VAR
ASSERT(WORD_TO_BOOL(w));
w := 0;
ASSERT(NOT WORD_TO_BOOL(w));
END_TEST
TEST 'shifts'
VAR w : WORD := 16#8001; n : INT; large : ULINT := 16#8000_0000_0000_0000; END_VAR
ASSERT(SHL(w, large) = WORD#0);
ASSERT(SHR(w, large) = WORD#0);
ASSERT(ROL(w, large) = w);
n := 16;
ASSERT(SHL(w, n) = WORD#0);
ASSERT(SHR(w, n) = WORD#0);
n := 1000;
ASSERT(SHL(w, n) = WORD#0);
n := -1;
ASSERT(SHL(w, n) = w);
ASSERT(SHR(w, n) = w);
ASSERT(ROL(w, n) = WORD#16#C000);
ASSERT(ROR(w, n) = WORD#16#0003);
n := 17;
ASSERT(ROL(w, n) = WORD#16#0003);
END_TEST
TEST 'LIMIT'
VAR low, value, high : INT; END_VAR
low := 10; value := 5; high := 0;
ASSERT(LIMIT(low, value, high) = 0);
END_TEST
TEST 'LIMIT with NaN'
VAR zero, nan : LREAL; END_VAR
nan := zero / zero;
ASSERT(LIMIT(nan, 5.0, 100.0) = LREAL#5.0);
ASSERT(LIMIT(nan, 500.0, 100.0) = LREAL#100.0);
ASSERT(LIMIT(0.0, -5.0, nan) = LREAL#0.0);
ASSERT(LIMIT(0.0, 5.0, nan) = LREAL#5.0);
ASSERT(NOT IS_VALID(LIMIT(0.0, nan, 100.0)));
END_TEST
TEST 'MAX and MIN with NaN'
VAR zero, nan : LREAL; END_VAR
nan := zero / zero;
ASSERT(MAX(nan, 1.0) = LREAL#1.0);
ASSERT(MIN(nan, 1.0) = LREAL#1.0);
ASSERT(NOT IS_VALID(MAX(1.0, nan)));
ASSERT(NOT IS_VALID(MIN(1.0, nan)));
ASSERT(MAX(1.0, nan, 0.5) = LREAL#0.5);
END_TEST
TEST 'MUX'
VAR k : INT := -1; END_VAR
ASSERT(MUX(k, 10, 20, 30) = 10);
k := 9;
ASSERT(MUX(k, 10, 20, 30) = 30);
END_TEST
TEST 'a time before 1970'
VAR t : DT; END_VAR
t := t - T#5h;
ASSERT(DT_TO_TOD(t) = TOD#19:00:00);
ASSERT(DATE_TO_LINT(DT_TO_DATE(t)) = -86400000000000);
END_TEST
TEST 'a number with a sign to a longer bit string'
VAR s : SINT := -1; END_VAR
ASSERT(SINT_TO_WORD(s) = 16#FFFF);
ASSERT(BYTE_TO_WORD(SINT_TO_BYTE(s)) = 16#00FF);
END_TEST
TEST 'parts of strings'
VAR s : STRING := 'abc'; n : INT := -1; large : ULINT := 16#8000_0000_0000_0000; END_VAR
ASSERT(LEFT(s, large) = 'abc');
ASSERT(MUX(large, 1, 2) = 2);
ASSERT(LEFT(s, n) = '');
ASSERT(RIGHT(s, n) = '');
ASSERT(MID(s, n, 1) = '');
n := 10;
ASSERT(LEFT(s, n) = 'abc');
ASSERT(RIGHT(s, n) = 'abc');
ASSERT(MID(s, n, 2) = 'bc');
END_TEST
TEST 'FOR'
VAR i, last, rounds : INT; u : USINT; END_VAR
FOR i := 1 TO 3 DO rounds := rounds + 1; END_FOR;
ASSERT(i = 4);
FOR u := 250 TO 255 DO rounds := rounds + 1; END_FOR;
ASSERT(rounds = 9);
ASSERT(u = USINT#0);
last := 1;
FOR i := 5 TO last DO rounds := 0; END_FOR;
ASSERT(i = 5 AND rounds = 9);
END_TEST
TEST 'x ** 0'
VAR zero : LREAL; END_VAR
zero := 0.0;
ASSERT(ABS(zero ** 0 - 1.0) < 0.001);
END_TEST
";

#[test]
fn what_the_standard_leaves_open_is_as_the_page_says() {
    let folder = Folder::new();
    folder.write("main.st", MAIN);
    folder.write("t.st", TESTS);
    let ended = folder.takt_plc(&["test", "main.st", "t.st"]);
    ended.expect(0, "test: 22 tests, all as expected");
}

#[test]
fn a_remainder_by_zero_is_a_trap() {
    let folder = Folder::new();
    folder.write("main.st", MAIN);
    folder.write(
        "t.st",
        "TEST 'MOD'\nVAR x, zero : INT; END_VAR\nx := 7 MOD zero;\nASSERT(x = 0);\nEND_TEST\n",
    );
    folder.takt_plc(&["test", "main.st", "t.st"]).expect(1, "t.st:3: division by zero");
}
