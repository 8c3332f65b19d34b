//! The command that has measured, as somebody would have to type it again.

use std::ffi::OsString;

/// The words as one line for a shell.
pub fn line(words: impl IntoIterator<Item = OsString>) -> String {
    let quoted: Vec<String> =
        words.into_iter().map(|word| quote(&word.to_string_lossy())).collect();
    quoted.join(" ")
}

fn quote(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_that_a_shell_would_cut_are_quoted() {
        let words = ["takt-jitter", "my file.toml", "it's", "", "--for=60s"];
        let line = line(words.map(OsString::from));
        assert_eq!(line, r"takt-jitter 'my file.toml' 'it'\''s' '' --for=60s");
    }
}
