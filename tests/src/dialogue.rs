//! Talking to a console: a test waits for what it shows, and answers.

use std::io::{Read, Write};
use std::process::Child;
use std::thread;

/// Reads all output, and answers the next cue of the dialogue whenever it appears.
pub fn converse(child: &mut Child, dialogue: &[(&str, &str)]) -> String {
    let mut errors = child.stderr.take().expect("stderr is a pipe");
    let errors = thread::spawn(move || {
        let mut text = String::new();
        let _ = errors.read_to_string(&mut text);
        text
    });
    let mut console = child.stdout.take().expect("stdout is a pipe");
    let mut keyboard = child.stdin.take();
    let mut dialogue = dialogue.iter();
    let mut next = dialogue.next();
    let (mut seen, mut answered) = (Vec::new(), 0);
    let mut buffer = [0; 4096];
    while let Ok(read @ 1..) = console.read(&mut buffer) {
        seen.extend_from_slice(&buffer[..read]);
        while let (Some((cue, answer)), Some(keyboard)) = (next, &mut keyboard) {
            let Some(end) = end_of(cue, &seen[answered..]) else { break };
            answered += end;
            keyboard.write_all(answer.as_bytes()).expect("somebody reads the keyboard");
            next = dialogue.next();
        }
    }
    let errors = errors.join().unwrap_or_default();
    String::from_utf8_lossy(&seen).into_owned() + &errors
}

/// Where a text ends in what a console has shown. A line of Takt's, or of a partition that has its name before its
/// lines, may come in the middle of a line of Linux and so of the text.
pub fn end_of(wanted: &str, shown: &[u8]) -> Option<usize> {
    let find = |text: &[u8]| text.windows(wanted.len()).position(|part| part == wanted.as_bytes());
    if let Some(at) = find(shown) {
        return Some(at + wanted.len());
    }
    let (mut text, mut places) = (Vec::new(), Vec::new());
    let mut at = 0;
    for line in shown.split_inclusive(|byte| *byte == b'\n') {
        if matches!(line, [b'[', b'a'..=b'z', ..]) {
            // The line break before it is not the guest's.
            while text.last().is_some_and(|byte| matches!(byte, b'\r' | b'\n')) {
                text.pop();
                places.pop();
            }
        } else {
            text.extend_from_slice(line);
            places.extend(at..at + line.len());
        }
        at += line.len();
    }
    find(&text).and_then(|start| places.get(start + wanted.len() - 1)).map(|last| last + 1)
}

#[cfg(test)]
mod tests {
    use super::end_of;

    #[test]
    fn a_text_is_found_although_other_lines_come_in_its_middle() {
        assert_eq!(end_of("on 1: 42", b"and on 1: 42\n"), Some(12));
        let shown =
            b"linux#\r\n[takt] plc: deadline-missed: release 7\r\n[plc] cycle 9\r\n \x1b[6n";
        assert_eq!(end_of("linux# ", shown).map(|end| &shown[end..]), Some(&b"\x1b[6n"[..]));
        let kernel = b"[    0.1] AC\n[plc] cycle 9\nPI: b\n";
        assert_eq!(end_of("ACPI", kernel).map(|end| &kernel[end..]), Some(&b": b\n"[..]));
        assert_eq!(end_of("0.2", kernel), None);
        assert_eq!(end_of("lines", b"li\n[ta"), None);
    }
}
