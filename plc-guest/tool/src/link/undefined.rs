//! What a linker did not find, where it is used, and what to do about it.

use std::collections::BTreeMap;
use std::path::Path;

use super::LinkError;

/// The error about symbols that were not found, from what GNU's and LLVM's linkers say; none if they say something else.
pub fn error(output: &str) -> Option<LinkError> {
    let symbols = symbols(output);
    let here = std::env::current_dir().unwrap_or_default();
    let hints = hints(&symbols.keys().map(String::as_str).collect::<Vec<_>>());
    let one = |(name, place): (String, Option<String>)| match place {
        None => name,
        Some(place) => {
            let place =
                Path::new(&place).strip_prefix(&here).unwrap_or(Path::new(&place)).display();
            format!("{name} ({place})")
        }
    };
    let symbols: Vec<_> = symbols.into_iter().map(one).collect();
    (!symbols.is_empty()).then_some(LinkError::Unresolved { symbols, hints })
}

/// Whether a function is missing that the tool brings.
pub fn of_math(output: &str) -> bool {
    const NAMES: [&str; 27] = [
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "sinh",
        "cosh",
        "tanh",
        "asinh",
        "acosh",
        "atanh",
        "exp",
        "exp2",
        "expm1",
        "log",
        "log2",
        "log10",
        "log1p",
        "cbrt",
        "rint",
        "atan2",
        "pow",
        "hypot",
        "fdim",
        "remainder",
        "ldexp",
    ];
    symbols(output).keys().any(|name| {
        NAMES.contains(&name.as_str())
            || name.strip_suffix('f').is_some_and(|name| NAMES.contains(&name))
    })
}

/// Each symbol with the first place that uses it: file and line, or else the function.
fn symbols(output: &str) -> BTreeMap<String, Option<String>> {
    let mut symbols: BTreeMap<String, Option<String>> = BTreeMap::new();
    // Of GNU's linker, the function in which the next ones are; of LLVM's, the symbol which the next place uses.
    let (mut function, mut last) = (None, None);
    for line in output.lines() {
        if let Some((_, rest)) = line.split_once("in function `") {
            function = Some(rest.trim_end_matches(':').trim_end_matches('\'').to_owned());
        } else if let Some((place, name)) = line.split_once("undefined reference to `") {
            let name = name.trim_end_matches('\'').to_owned();
            let in_function = || function.as_ref().map(|function| format!("in {function}"));
            let place = in_source(place.trim_end().trim_end_matches(':')).or_else(in_function);
            symbols.entry(name).or_insert(place);
        } else if let Some((_, name)) = line.split_once("undefined symbol: ") {
            last = Some(name.trim_end().to_owned());
            symbols.entry(name.trim_end().to_owned()).or_insert(None);
        } else if let Some(place) = line.strip_prefix(">>> referenced by ")
            && let Some(found) = last.take().and_then(|name| symbols.get_mut(&name))
        {
            // `a.c:12 (/folder/a.c:12)`, or the object file.
            *found = in_source(place.split(" (").next().unwrap_or(place));
        }
    }
    symbols
}

/// `a.c:12`, if that is what stands at the end; the linker may have put its own name in front.
fn in_source(place: &str) -> Option<String> {
    let (file, line) = place.rsplit_once(':')?;
    let file = file.rsplit_once(": ").map_or(file, |(_, file)| file);
    let number = !line.is_empty() && line.bytes().all(|byte| byte.is_ascii_digit());
    number.then(|| format!("{file}:{line}"))
}

fn hints(symbols: &[&str]) -> String {
    const HINTS: [(&[&str], &str); 6] = [
        (
            &["memcpy", "memmove", "memset", "memcmp", "takt_logf"],
            "The memory functions and takt_logf are in takt.c of the SDK: compile and link it too",
        ),
        (&["__stack_chk_fail"], "Compile with -fno-stack-protector"),
        (
            &[
                "malloc",
                "calloc",
                "realloc",
                "free",
                "printf",
                "sprintf",
                "snprintf",
                "puts",
                "putchar",
                "exit",
                "abort",
                "strlen",
                "strcmp",
                "strcpy",
                "strncpy",
                "fopen",
                "time",
                "__errno_location",
                "__printf_chk",
                "__sprintf_chk",
            ],
            "A control program has no C library: compile with -ffreestanding and bring what it needs; takt_logf logs numbers",
        ),
        (
            &[
                "sqrt", "fabs", "copysign", "trunc", "floor", "ceil", "round", "fmin", "fmax",
                "fmod",
            ],
            "The exact functions of math.h are in takt_math.c of the SDK: compile and link it too",
        ),
        (
            &[
                "__udivti3",
                "__umodti3",
                "__divti3",
                "__modti3",
                "__udivmodti4",
                "__floattidf",
                "__floatuntidf",
                "__floattisf",
                "__floatuntisf",
                "__fixdfti",
                "__fixunsdfti",
                "__powidf2",
                "__powisf2",
                "__popcountdi2",
                "__muldc3",
                "__divdc3",
            ],
            "These are in the compiler's own library: give `gcc -print-libgcc-file-name` as an input, too",
        ),
        (
            &["__tls_get_addr"],
            "The program has thread-local variables, and a control program has no threads",
        ),
    ];
    // The functions for `float` end with an f.
    let is = |symbol: &str, names: &[&str]| {
        names.contains(&symbol)
            || symbol.strip_suffix('f').is_some_and(|name| names.contains(&name))
    };
    let fits = |names: &[&str]| symbols.iter().any(|symbol| is(symbol, names));
    let hints = HINTS.iter().filter(|(names, _)| fits(names)).map(|(_, hint)| format!(". {hint}"));
    hints.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(output: &str) -> Vec<String> {
        let one = |(name, place): (String, Option<String>)| {
            format!("{name} {}", place.as_deref().unwrap_or("?"))
        };
        symbols(output).into_iter().map(one).collect()
    }

    #[test]
    fn undefined_symbols_are_found_in_what_both_linkers_say() {
        let gnu = "ld: a.o: in function `f':\na.c:(.text+0x5): undefined reference to `sin'\n\
                   ld: b.c:3: undefined reference to `sin'\n/usr/bin/ld: b.c:4: undefined reference to `cos'\n";
        assert_eq!(found(gnu), ["cos b.c:4", "sin in f"]);
        let llvm = "ld.lld: error: undefined symbol: cos\n>>> referenced by a.c:7 (/x/a.c:7)\n\
                    >>>               a.o:(f)\n>>> referenced by a.c:9 (/x/a.c:9)\n\n\
                    ld.lld: error: undefined symbol: sin\n>>> referenced by a.o:(f)\n";
        assert_eq!(found(llvm), ["cos a.c:7", "sin ?"]);
        assert!(error("ld: cannot open a.o").is_none());
    }

    #[test]
    fn each_kind_of_symbol_has_its_hint() {
        let both = hints(&["printf", "sqrtf"]);
        assert!(both.contains("no C library") && both.contains("takt_math.c"), "{both}");
        assert!(hints(&["__udivti3"]).contains("-print-libgcc-file-name"));
        assert!(hints(&["sqrtf"]).contains("takt_math.c"));
        assert_eq!(hints(&["mine"]), "");
    }
}
