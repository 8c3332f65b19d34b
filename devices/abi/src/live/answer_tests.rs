//! Each answer comes back as it was written, and no message that is cut or lies is taken.

use super::*;

fn answers() -> [Answer; 5] {
    let program = ProgramRecord { state: ProgramState::Running, hash: [7; 32] };
    let task = TaskRecord {
        program: 1,
        state: TaskState::Ready,
        number: Some(3),
        jobs: 1 << 40,
        slack_min: u64::MAX,
        ..TaskRecord::default()
    };
    let programs = [program; PROGRAMS_MAX];
    let count = PROGRAMS_MAX as u8;
    let phase = super::super::ChangePhase::Trial;
    let change = ChangeRecord { program: 2, phase, took: 1 << 33, ..ChangeRecord::default() };
    [
        Answer::Change(change),
        Answer::Reply(Ok(())),
        Answer::Reply(Err(Refusal::NoProgram)),
        Answer::Programs { programs, count, tasks: 64, forced: 3, dropped: 5 },
        Answer::Tasks { first: 8, count: 8, tasks: [task; TASKS_EACH] },
    ]
}

#[test]
fn the_longest_answers_have_room_and_are_read_as_they_were_written() {
    for answer in answers() {
        let mut buffer = [0; MESSAGE_BYTES];
        let message = answer.encode(3, &mut buffer).unwrap();
        assert_eq!(decode_answer(message), Some((3, answer)));
        for length in 0..message.len() {
            assert_eq!(decode_answer(&message[..length]), None);
        }
    }
}

#[test]
fn what_no_kernel_would_write_is_no_answer() {
    let mut buffer = [0; MESSAGE_BYTES];
    let [.., programs, _] = answers();
    let message = programs.encode(3, &mut buffer).unwrap().to_vec();
    let changed = |at: usize, to: u8| {
        let mut changed = message.clone();
        changed[at] = to;
        decode_answer(&changed)
    };
    assert_eq!(changed(0, 99), None, "its kind");
    assert_eq!(changed(2, 1), None, "the zero");
    assert_eq!(changed(8, 17), None, "more programs than there can be");
    assert_eq!(changed(8, 15), None, "a program that is not counted");
    assert_eq!(changed(20, 4), None, "the state of a program");
}
