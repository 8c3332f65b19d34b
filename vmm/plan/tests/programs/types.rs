//! Inputs have the types of the outputs that they are connected to.

use takt_plan::check::report;
use takt_program::build::{Builder, Field, Kind, Type, Variable};
use takt_program::{Area, Elementary, TypeId};

use super::Case;
use super::images::builder;

/// Makes a type in an image.
type Make<'a> = &'a dyn Fn(&mut Builder) -> TypeId;

/// A program with one point of this type at byte 0, a BOOL as a whole byte.
fn one(name: &str, area: Area, make: Make<'_>) -> Vec<u8> {
    let mut program = builder(name);
    (program.input_bytes, program.output_bytes) = (64, 64);
    let ty = make(&mut program);
    program.variable(Variable::new("value", ty, area, 0));
    program.build().unwrap()
}

/// A file in which the point of the program `sink` is an input, and that of `source` an output, without connections.
fn case(from: Make<'_>, to: Make<'_>) -> Case {
    let thread = std::thread::current();
    let case = Case::new(thread.name().unwrap_or("types"));
    case.file("source.plc", &one("source", Area::Output, from))
        .file("sink.plc", &one("sink", Area::Input, to))
        .program("source.plc", "")
        .program("sink.plc", "")
}

fn connected(from: Make<'_>, to: Make<'_>) -> Case {
    case(from, to).with(
        "[[partition.io]]\nprogram = \"sink\"\npoint = \"value\"\n\
         output = \"value\"\noutput_of = \"source\"",
    )
}

fn elementary(ty: Elementary) -> impl Fn(&mut Builder) -> TypeId {
    move |program| program.elementary(ty)
}

#[test]
fn elementary_types_go_with_themselves_and_with_bit_strings_of_their_size() {
    use Elementary::*;
    let bits = [Byte, Word, Dword, Lword];
    let pairs = [(Time, Ltime), (Date, Ldate), (Tod, Ltod), (Dt, Ldt)];
    for from in Elementary::ALL.iter().copied() {
        for to in Elementary::ALL.iter().copied() {
            let same = from == to || pairs.contains(&(from, to)) || pairs.contains(&(to, from));
            let raw = bits.contains(&from) || bits.contains(&to);
            let raw = raw && from.bytes() == to.bytes() && from != Bool && to != Bool;
            let case = connected(&elementary(from), &elementary(to));
            if same || raw {
                case.good();
                continue;
            }
            let is = |ty: Elementary| format!("is of type {}", ty.keyword());
            let place = "case.toml:20:10: the output \"value\" is of type ";
            case.refused(&[place, &is(from), &is(to)]);
        }
    }
}

#[test]
fn a_refusal_says_what_is_there_and_what_is_allowed() {
    use Elementary::{Dint, Ltime, Real, Sint, Ulint, Word};
    let refused =
        |from, to, words: &[&str]| connected(&elementary(from), &elementary(to)).refused(words);
    refused(
        Real,
        Dint,
        &[
            "the output \"value\" is of type REAL, and the input \"value\" is of type DINT",
            "20 | output = \"value\"",
            "allowed: an output of type DINT, or DWORD for the bits alone",
        ],
    );
    refused(Ulint, Ltime, &["allowed: an output of type TIME or LTIME, or LWORD for"]);
    refused(Sint, Word, &["SINT (1 byte)", "WORD (2 bytes)", "an output of any type of 2 bytes"]);
}

fn array(ty: Elementary, count: u32) -> impl Fn(&mut Builder) -> TypeId {
    move |program| {
        let element = program.elementary(ty);
        let array = Kind::Array { element, lower: 1, upper: i64::from(count) };
        program.ty(Type::new(ty.bytes() * count, array))
    }
}

/// A structure of 16 bytes with this type at byte 8, behind an array of two INT at byte 4.
fn structure(ty: Elementary) -> impl Fn(&mut Builder) -> TypeId {
    move |program| {
        let pair = array(Elementary::Int, 2)(program);
        let last = program.elementary(ty);
        let field = |name: &str, ty, offset| Field { name: name.to_owned(), ty, offset };
        let fields = vec![field("pair", pair, 4), field("last", last, 8)];
        program.ty(Type::new(16, Kind::Structure { fields }).named("both"))
    }
}

#[test]
fn arrays_and_structures_are_compared_part_by_part() {
    use Elementary::{Bool, Byte, Dint, Dword, Int, Real, Udint, Uint};
    connected(&array(Int, 4), &array(Int, 4)).good();
    connected(&array(Byte, 16), &structure(Real)).good();
    connected(&array(Bool, 3), &array(Bool, 3)).good();
    connected(&structure(Real), &structure(Real)).good();
    connected(&structure(Real), &structure(Dword)).good();
    let refused = |from: Make<'_>, to: Make<'_>, words: &[&str]| connected(from, to).refused(words);
    let wrong = [
        "is of type ARRAY[1..4] OF INT, and the input \"value\" is of type ARRAY[1..4] OF UINT",
        "allowed: an output that at byte 0 is of type UINT, or WORD",
    ];
    refused(&array(Int, 4), &array(Uint, 4), &wrong);
    refused(&structure(Real), &structure(Dint), &["at byte 8 is of type DINT"]);
    refused(&array(Dint, 4), &structure(Dint), &["at byte 4 is of type INT"]);
    refused(&array(Dint, 2), &array(Int, 4), &["at byte 0 is of type INT"]);
    let wrong =
        ["OF INT (8 bytes)", "OF INT (6 bytes)", "an output of 6 bytes with the same parts"];
    refused(&array(Int, 4), &array(Int, 3), &wrong);
    refused(&elementary(Udint), &array(Byte, 3), &["an output of 3 bytes"]);
}

fn enumeration<'a>(
    base: Elementary,
    values: &'a [(&'a str, i64)],
) -> impl Fn(&mut Builder) -> TypeId + 'a {
    move |program| {
        let values = values.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
        program.ty(Type::new(base.bytes(), Kind::Enumeration { base, values }).named("mode"))
    }
}

#[test]
fn values_of_enumerations_have_the_same_names() {
    use Elementary::{Dint, Int, Uint, Word};
    let modes = enumeration(Int, &[("off", 0), ("auto", 1)]);
    let more = enumeration(Int, &[("OFF", 0), ("Auto", 1), ("manual", 2)]);
    let other = enumeration(Int, &[("off", 0), ("manual", 1), ("auto", 2)]);
    let low = |program: &mut Builder| {
        program.ty(Type::new(2, Kind::Subrange { base: Int, low: 0, high: 9 }))
    };
    connected(&modes, &more).good();
    connected(&modes, &elementary(Int)).good();
    connected(&elementary(Word), &modes).good();
    connected(&low, &modes).good();
    connected(&low, &elementary(Int)).good();
    let refused = |from: Make<'_>, to: Make<'_>, words: &[&str]| connected(from, to).refused(words);
    refused(&more, &modes, &["of type mode", "type INT, or WORD for the bits alone, or an enum"]);
    refused(&modes, &other, &["an enumeration of the same values"]);
    refused(&modes, &elementary(Uint), &["of type UINT"]);
    refused(&modes, &enumeration(Dint, &[("off", 0)]), &["mode (2 bytes)", "mode (4 bytes)"]);
}

fn text(length: u32, wide: bool, bytes: u32) -> impl Fn(&mut Builder) -> TypeId {
    move |program| {
        let kind = if wide { Kind::WString { length } } else { Kind::String { length } };
        program.ty(Type::new(bytes, kind))
    }
}

#[test]
fn texts_have_the_same_length_and_references_stay_in_their_program() {
    use Elementary::{Byte, Char, Lword};
    connected(&text(7, false, 8), &text(7, false, 8)).good();
    connected(&text(7, false, 8), &array(Byte, 8)).good();
    let refused = |from: Make<'_>, to: Make<'_>, words: &[&str]| connected(from, to).refused(words);
    refused(&text(7, false, 8), &text(6, false, 8), &["an output of type STRING[6]"]);
    refused(&text(3, false, 8), &text(3, true, 8), &["an output of type WSTRING[3]"]);
    refused(&text(7, false, 8), &array(Char, 8), &["at byte 0 is of type CHAR, or BYTE"]);
    let reference = |program: &mut Builder| {
        let target = program.elementary(Lword);
        program.ty(Type::new(8, Kind::Reference { target }))
    };
    refused(&reference, &reference, &["REF_TO LWORD", "in another program"]);
    connected(&reference, &elementary(Lword)).good();
}

#[test]
fn an_address_of_a_point_has_its_type_and_others_are_bits() {
    use Elementary::{Bool, Dint, Real};
    let (real, dint) = (elementary(Real), elementary(Dint));
    let at = |from: Make<'_>, to: Make<'_>, input: &str, output: &str| {
        let table = format!(
            "[[partition.io]]\nprogram = \"sink\"\nat = \"{input}\"\n\
             output = \"{output}\"\noutput_of = \"source\""
        );
        case(from, to).with(&table)
    };
    at(&real, &real, "%ID0", "%QD0").good();
    // Nothing is declared there, or not of this size.
    at(&real, &dint, "%ID1", "%QD0").good();
    at(&real, &dint, "%IW0", "%QW1").good();
    at(&real, &dint, "%ID0", "%QD0")
        .refused(&["the output \"%QD0\" is of type REAL, and the input \"%ID0\""]);
    at(&real, &elementary(Bool), "%IB0", "%QB0")
        .refused(&["BYTE (1 byte), and the input \"%IB0\" is of type BOOL"]);

    // What is simulated at an address is a value of the type there, too.
    let simulated = |at: &str| {
        let table = format!(
            "[[partition.io]]\nprogram = \"sink\"\nat = \"{at}\"\n\
             simulate = {{ shape = \"constant\", value = 2.5 }}"
        );
        let file = case(&real, &real).with(&table).good();
        file.partitions()[0].connections()[0].mapping.ty
    };
    assert_eq!(simulated("%ID0"), u32::from(Real.code()));
    assert_eq!(simulated("%ID1"), u32::from(Elementary::Dword.code()));
}

/// A second partition with the program `sink`, and a channel to it.
const OTHER: &str = "[[schedule.window]]\npartition = \"other\"\noffset = \"600us\"\nduration = \"200us\"\n\
    [[partition]]\nname = \"other\"\nkind = \"plc\"\ncpu = 0\nmemory = \"16MiB\"\nimage = \"guest\"\n\
    [[partition.program]]\nimage = \"sink.plc\"\n\
    [[channel]]\nname = \"unused\"\nkind = \"sampling\"\nmessage_bytes = 8\nrefresh_period = \"10ms\"\n\
    source = \"plc:unused\"\ndestinations = [\"host:unused\"]\nhost_file = \"unused.log\"\n\
    [[channel]]\nname = \"values\"\nkind = \"sampling\"\nmessage_bytes = 20\nrefresh_period = \"10ms\"\n\
    source = \"plc:values\"\ndestinations = [\"other:taken\"]\n";

#[test]
fn both_ends_of_a_channel_have_the_same_types() {
    use Elementary::{Bool, Byte, Dint, Int, Real, Uint, Word};
    // The output at byte 4; and the input, with these keys.
    let with = |from: Make<'_>, to: Make<'_>, place: &str, keys: &str| {
        let case = case(from, to).with(&format!(
            "[[partition.io]]\nprogram = \"source\"\npoint = \"value\"\nchannel = \"values\"\n{place}"
        ));
        let input = "[[partition.io]]\npoint = \"value\"\nchannel = \"taken\"\n";
        let (partition, channels) = OTHER.split_at(OTHER.find("[[channel]]").unwrap());
        case.ending(&format!("{partition}{input}{keys}\n{channels}"))
    };
    let (real, dint, bool_type) = (elementary(Real), elementary(Dint), elementary(Bool));
    with(&real, &real, "byte = 4", "byte = 4").good();
    with(&real, &dint, "byte = 4", "byte = 8").good();
    with(&array(Real, 4), &real, "byte = 4", "byte = 12").good();
    with(&real, &elementary(Word), "byte = 4", "byte = 6").good();
    with(&elementary(Byte), &bool_type, "byte = 4", "byte = 4\nbit = 3").good();
    with(&bool_type, &bool_type, "byte = 4\nbit = 3", "byte = 4\nbit = 3").good();
    with(&bool_type, &bool_type, "byte = 4\nbit = 3", "byte = 4\nbit = 4").good();
    with(&bool_type, &bool_type, "byte = 4", "byte = 4\nbit = 0").good();
    let wrong = [
        "case.toml:44:11:",
        "\"value\" of type DINT in \"other\" reads byte 4 of the channel \"values\", where the output \
         \"value\" of type REAL is written",
        "what is written",
        "allowed: an output of type DINT, or DWORD for the bits alone there",
    ];
    with(&real, &dint, "byte = 4", "byte = 4").refused(&wrong);
    with(&array(Real, 4), &dint, "byte = 4", "byte = 12").refused(&["reads byte 12"]);
    with(&real, &real, "byte = 4", "byte = 6").refused(&["reads byte 6", "an output of type REAL"]);
    with(&elementary(Uint), &elementary(Int), "byte = 4", "byte = 4").refused(&["of type INT"]);
    with(&elementary(Uint), &bool_type, "byte = 4", "byte = 5\nbit = 0")
        .refused(&["bit 0 of byte 5"]);
    with(&bool_type, &bool_type, "byte = 4\nbit = 3", "byte = 4").refused(&["of type BOOL"]);
    with(&structure(Real), &structure(Dint), "byte = 4", "byte = 4").refused(&["reads byte 12"]);
}

#[test]
fn a_report_writes_types_as_structured_text_does() {
    let file = connected(&array(Elementary::Int, 4), &array(Elementary::Int, 4)).good();
    let text = report(&file);
    assert!(text.contains("%IB0   value  ARRAY[1..4] OF INT  -"), "{text}");
}
