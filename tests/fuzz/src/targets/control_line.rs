//! A line from a client that may open the control socket.

use takt_protocol::Request;

/// Reads the line.
///
/// # Panics
/// If a request does not survive being written and read again, or a refusal says nothing.
pub fn run(data: &[u8]) {
    match Request::parse(data) {
        Ok(request) => {
            let line = request.line();
            let again = Request::parse(&line);
            assert!(again.is_ok_and(|again| again.line() == line));
        }
        Err(refusal) => assert!(!refusal.text.is_empty()),
    }
}
