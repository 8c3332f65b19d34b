//! Releases, limits and the lives of programs, in time.

use crate::objects::{Object, ObjectId, Received, Seen};
use crate::scheduler::{Phase, Scheduler, Violation};
use crate::statistics::Statistics;
use crate::task::{ProgramId, Release, Settings, State, TaskId, Wait, Wake};
use crate::time::{Instant, Span};
use takt_program::call::Error;

type Small = Scheduler<8, 2, 8>;

const PROGRAM: ProgramId = ProgramId(0);

fn settings(release: Release, priority: u8) -> Settings {
    Settings {
        program: PROGRAM,
        release,
        priority,
        deadline: Span::ZERO,
        budget: Span::ZERO,
        sensitivity: 0,
    }
}

fn cyclic(period: u64, offset: u64, priority: u8) -> Settings {
    settings(Release::Cyclic { period: Span(period), offset: Span(offset) }, priority)
}

/// A program with these tasks that has started at 0, with a queue, flags and a semaphore of ceiling 1.
fn started(tasks: &[Settings]) -> Small {
    let mut s = Small::new();
    let objects = [Object::queue(2), Object::Flags(0), Object::semaphore(1), Object::mailbox()];
    assert_eq!(s.add_program(objects.into_iter()), Ok(PROGRAM));
    for settings in tasks {
        assert!(s.add_task(*settings).is_ok());
    }
    s.start(PROGRAM, Instant(0));
    s
}

/// Who runs at an instant.
fn at(s: &mut Small, now: u64) -> Option<u8> {
    s.advance(Instant(now));
    s.pick().map(|picked| picked.task.0)
}

#[test]
fn releases_are_at_whole_periods_after_the_offset() {
    let mut s = started(&[cyclic(100, 30, 0)]);
    for (now, runs) in
        [(0, None), (29, None), (30, Some(0)), (129, None), (130, Some(0)), (229, None)]
    {
        assert_eq!(at(&mut s, now), runs, "{now}");
        s.end(Instant(now));
    }
}

#[test]
fn an_initialisation_without_an_end_leaves_half_of_the_rest_to_another() {
    let mut s = Small::new();
    for program in [0, 1] {
        assert_eq!(s.add_program([].into_iter()), Ok(ProgramId(program)));
        let settings = Settings { program: ProgramId(program), ..settings(Release::Start, 255) };
        assert!(s.add_task(settings).is_ok());
        s.start(ProgramId(program), Instant(0));
    }
    let mut turns = [0; 2];
    for window in 0..10 {
        let runs = at(&mut s, window * 100).unwrap();
        turns[usize::from(runs)] += 1;
        assert_eq!(s.account(s.running().unwrap(), Span(10)), None);
    }
    assert_eq!(turns, [5, 5]);
}

#[test]
fn a_release_that_comes_late_keeps_its_instant_and_moves_no_other() {
    let mut s = started(&[cyclic(100, 0, 0)]);
    assert_eq!(at(&mut s, 37), Some(0));
    assert_eq!(s.task(TaskId(0)).released(), Instant(0));
    s.end(Instant(40));
    // The scheduler was not called between 100 and 350.
    assert_eq!(at(&mut s, 350), Some(0));
    let task = s.task(TaskId(0));
    assert_eq!((task.released(), task.elapsed()), (Instant(300), Span(300)));
    assert_eq!(task.statistics().overruns, 2);
    s.end(Instant(360));
    assert_eq!((at(&mut s, 399), at(&mut s, 400)), (None, Some(0)));
}

#[test]
fn a_program_is_between_jobs_when_each_has_ended_or_was_abandoned() {
    let mut s = started(&[cyclic(100, 0, 1), cyclic(100, 50, 0)]);
    assert!(s.is_between_jobs(PROGRAM));
    assert_eq!(at(&mut s, 0), Some(0));
    assert!(!s.is_between_jobs(PROGRAM));
    // One that waits in the middle of its job has one too.
    assert_eq!(at(&mut s, 50), Some(1));
    s.end(Instant(55));
    assert!(!s.is_between_jobs(PROGRAM));
    s.abandon(PROGRAM, Instant(60));
    assert!(s.is_between_jobs(PROGRAM));
    assert_eq!((s.running(), s.task(TaskId(0)).statistics().skipped), (None, 1));
    // The next releases are where they were.
    assert_eq!((at(&mut s, 99), at(&mut s, 100)), (None, Some(0)));
    s.stop(PROGRAM);
    assert!(!s.is_between_jobs(PROGRAM), "it does not run");
}

#[test]
fn a_release_during_the_job_before_is_lost_and_counted() {
    let mut s = started(&[cyclic(100, 0, 0)]);
    assert_eq!(at(&mut s, 0), Some(0));
    assert_eq!(at(&mut s, 250), Some(0));
    assert_eq!(s.task(TaskId(0)).statistics().overruns, 2);
    s.end(Instant(260));
    assert_eq!((at(&mut s, 299), at(&mut s, 300)), (None, Some(0)));
}

#[test]
fn the_more_urgent_task_preempts_and_the_other_goes_on_where_it_was() {
    let mut s = started(&[cyclic(1000, 0, 5), cyclic(100, 50, 1)]);
    s.advance(Instant(0));
    let first = s.pick().expect("it is ready");
    assert!(first.task == TaskId(0) && first.begins);
    assert_eq!(at(&mut s, 50), Some(1));
    s.end(Instant(60));
    let again = s.pick().expect("it is ready");
    assert!(again.task == TaskId(0) && !again.begins);
    assert_eq!(s.switches(), 3);
}

#[test]
fn equals_are_ranked_by_their_place_and_the_earlier_one_preempts() {
    let mut s = started(&[cyclic(100, 10, 3), cyclic(100, 0, 3)]);
    assert_eq!(at(&mut s, 0), Some(1));
    assert_eq!(at(&mut s, 10), Some(0));
}

#[test]
fn an_event_task_keeps_its_minimum_and_forgets_no_event() {
    let mut s = started(&[settings(Release::Event { minimum: Span(100) }, 0)]);
    let id = TaskId(0);
    assert_eq!(at(&mut s, 10), None);
    s.signal(id, Instant(10));
    assert_eq!(at(&mut s, 10), Some(0));
    assert!(!s.task(id).awaits_event());
    // Two during the job are one more, not before 110, and one that is lost.
    s.signal(id, Instant(11));
    assert_eq!(s.task(id).statistics().overruns, 0);
    s.signal(id, Instant(12));
    assert_eq!(s.task(id).statistics().overruns, 1);
    s.end(Instant(20));
    assert!(!s.task(id).awaits_event());
    assert_eq!((at(&mut s, 109), at(&mut s, 110)), (None, Some(0)));
    s.end(Instant(120));
    assert!(s.task(id).awaits_event());
    assert_eq!(at(&mut s, 500), None);
}

#[test]
fn what_stays_until_the_task_has_taken_it_is_one_release_and_never_lost() {
    let mut s = started(&[settings(Release::Event { minimum: Span(100) }, 0)]);
    let id = TaskId(0);
    // The same message, seen before its job, in it, and left there by it.
    for now in [10, 11, 12] {
        s.signal_again(id, Instant(now));
    }
    assert_eq!(at(&mut s, 12), Some(0));
    s.signal_again(id, Instant(13));
    s.end(Instant(20));
    assert!(s.task(id).awaits_event(), "what it has taken is no further event");
    assert_eq!(at(&mut s, 115), None);
    for now in [116, 117] {
        s.signal_again(id, Instant(now));
    }
    assert_eq!(at(&mut s, 117), Some(0));
    assert_eq!(s.task(id).statistics().overruns, 0);
}

#[test]
fn an_event_during_a_long_job_leads_to_the_next_at_once() {
    let mut s = started(&[settings(Release::Event { minimum: Span(100) }, 0)]);
    s.signal(TaskId(0), Instant(0));
    assert_eq!(at(&mut s, 0), Some(0));
    s.signal(TaskId(0), Instant(50));
    s.end(Instant(300));
    assert_eq!(at(&mut s, 300), Some(0));
    assert_eq!(s.task(TaskId(0)).released(), Instant(300));
}

#[test]
fn a_freewheeling_task_has_one_job_in_each_window() {
    let mut s = started(&[settings(Release::Freewheeling, 9)]);
    assert_eq!(at(&mut s, 0), None);
    s.window(Instant(0));
    assert_eq!(at(&mut s, 0), Some(0));
    s.window(Instant(100));
    s.end(Instant(150));
    assert_eq!(at(&mut s, 150), None);
    s.window(Instant(200));
    assert_eq!(at(&mut s, 200), Some(0));
    // It has no deadline, so a job that is complete leaves no slack.
    assert_eq!(Statistics::measured(s.task(TaskId(0)).statistics().slack_min), None);
}

#[test]
fn a_deadline_that_passes_is_told_once_and_before_the_job_ends() {
    let mut s = started(&[Settings { deadline: Span(50), ..cyclic(100, 0, 0) }]);
    assert_eq!(at(&mut s, 0), Some(0));
    s.advance(Instant(50));
    assert_eq!(s.take_late(), None);
    s.advance(Instant(51));
    assert_eq!((s.take_late(), s.take_late()), (Some(TaskId(0)), None));
    s.end(Instant(60));
    assert_eq!(s.take_late(), None);
    assert_eq!(s.task(TaskId(0)).statistics().misses, 1);
    assert_eq!(s.task(TaskId(0)).statistics().slack_min, Span(0));
}

#[test]
fn a_deadline_that_was_passed_unseen_is_told_at_the_end() {
    let mut s = started(&[Settings { deadline: Span(50), ..cyclic(100, 0, 0) }]);
    assert_eq!(at(&mut s, 0), Some(0));
    s.end(Instant(51));
    assert_eq!(s.take_late(), Some(TaskId(0)));
}

#[test]
fn a_job_over_its_budget_is_told_once() {
    let mut s = started(&[Settings { budget: Span(30), ..cyclic(100, 0, 0) }]);
    assert_eq!(at(&mut s, 0), Some(0));
    assert_eq!(s.account(s.running().unwrap(), Span(30)), None);
    assert_eq!(s.account(s.running().unwrap(), Span(1)), Some(Violation::Budget));
    assert_eq!(s.account(s.running().unwrap(), Span(10)), None);
    assert_eq!(s.end(Instant(41)), None);
    assert_eq!(s.task(TaskId(0)).statistics().over_budget, 1);
    // The next job has a budget of its own.
    assert_eq!(at(&mut s, 100), Some(0));
    assert_eq!(s.account(s.running().unwrap(), Span(30)), None);
}

#[test]
fn another_version_has_its_own_limits_and_the_rest_of_its_settings_stays() {
    let settings = Settings { budget: Span(30), deadline: Span(80), ..cyclic(100, 0, 1) };
    let mut s = started(&[settings]);
    assert_eq!(at(&mut s, 0), Some(0));
    s.end(Instant(10));
    let other = Settings { budget: Span(5), deadline: Span(20), sensitivity: 1, ..cyclic(7, 3, 9) };
    s.set_limits(TaskId(0), &other);
    let expected = Settings { budget: Span(5), deadline: Span(20), sensitivity: 1, ..settings };
    assert_eq!(*s.task(TaskId(0)).settings(), expected);
    assert_eq!(at(&mut s, 100), Some(0), "its releases are those that they were");
    assert_eq!(
        s.account(s.running().unwrap(), Span(11)),
        Some(Violation::Budget),
        "twice the budget at most"
    );
    s.advance(Instant(121));
    assert_eq!(s.take_late(), Some(TaskId(0)));
}

#[test]
fn jobs_before_a_restart_do_not_count_against_those_after_it() {
    let settings = Settings { budget: Span(10), sensitivity: 1, ..cyclic(100, 0, 0) };
    let mut s = started(&[settings]);
    let ends = |s: &mut Small, now| {
        assert_eq!(at(s, now), Some(0));
        assert_eq!(s.account(s.running().unwrap(), Span(15)), None);
        s.end(Instant(now + 15))
    };
    assert_eq!(ends(&mut s, 0), None);
    s.start(PROGRAM, Instant(100));
    assert_eq!([ends(&mut s, 100), ends(&mut s, 200)], [None, Some(Violation::Budget)]);
}

#[test]
fn a_skipped_job_gives_back_what_it_holds_and_the_task_goes_on() {
    let mut s = started(&[cyclic(100, 0, 1)]);
    assert_eq!(at(&mut s, 0), Some(0));
    assert_eq!(s.take(ObjectId(2)), Ok(()));
    s.skip(TaskId(0), Instant(10));
    assert_eq!(s.object_at(ObjectId(2)), Object::semaphore(1));
    assert_eq!((at(&mut s, 50), at(&mut s, 100)), (None, Some(0)));
    let statistics = s.task(TaskId(0)).statistics();
    assert_eq!((statistics.jobs, statistics.skipped), (0, 1));
    // What it has written is half written until a job of it has come to its end.
    assert!(s.task(TaskId(0)).was_cut());
    s.end(Instant(110));
    assert!(!s.task(TaskId(0)).was_cut());
}

#[test]
fn a_program_that_stops_itself_leaves_the_jobs_half_done_that_it_has_preempted() {
    let mut s = started(&[cyclic(100, 50, 0), cyclic(1_000, 0, 2), cyclic(1_000, 0, 3)]);
    assert_eq!(at(&mut s, 0), Some(1));
    assert_eq!(at(&mut s, 50), Some(0));
    s.stop(PROGRAM);
    let cut = [0, 1, 2].map(|id| s.task(TaskId(id)).was_cut());
    assert_eq!(cut, [false, true, false]);
}

#[test]
fn a_task_that_waits_for_an_event_is_not_half_done_until_the_next_one() {
    let mut s = started(&[settings(Release::Event { minimum: Span(100) }, 0)]);
    s.signal(TaskId(0), Instant(0));
    assert_eq!(at(&mut s, 0), Some(0));
    s.skip(TaskId(0), Instant(10));
    assert!(!s.task(TaskId(0)).was_cut());
}

#[test]
fn a_job_that_has_not_begun_leaves_nothing_half_written() {
    let mut s = started(&[cyclic(100, 0, 1), cyclic(100, 0, 2)]);
    assert_eq!(at(&mut s, 0), Some(0));
    s.skip(TaskId(1), Instant(10));
    assert!(!s.task(TaskId(1)).was_cut());
    s.skip(TaskId(0), Instant(10));
    assert!(s.task(TaskId(0)).was_cut());
    s.start(PROGRAM, Instant(100));
    assert!(!s.task(TaskId(0)).was_cut());
}

#[test]
fn a_violation_that_is_found_at_the_end_is_not_that_of_the_next_job() {
    let event = settings(Release::Event { minimum: Span(100) }, 0);
    let mut s = started(&[Settings { budget: Span(10), deadline: Span(50), ..event }]);
    s.signal(TaskId(0), Instant(0));
    assert_eq!(at(&mut s, 0), Some(0));
    assert_eq!(s.account(s.running().unwrap(), Span(11)), Some(Violation::Budget));
    assert!(s.task(TaskId(0)).has_violated());
    s.signal(TaskId(0), Instant(150));
    s.end(Instant(150));
    assert_eq!(s.take_late(), Some(TaskId(0)));
    assert_eq!(s.task(TaskId(0)).released(), Instant(150));
    assert!(!s.task(TaskId(0)).has_violated());
}

#[test]
fn a_wait_ends_with_its_time_and_says_so() {
    let mut s = started(&[cyclic(1000, 0, 0)]);
    assert_eq!(at(&mut s, 0), Some(0));
    assert_eq!(s.receive(ObjectId(0), Instant(5), Span(20)), Ok(Received::Waits));
    assert_eq!(at(&mut s, 24), None);
    assert_eq!(s.next_event(), Instant(25));
    s.advance(Instant(25));
    let picked = s.pick().expect("its time is up");
    assert_eq!((picked.begins, picked.wake), (false, Some(Wake::TimedOut)));
    assert_eq!(s.pick().and_then(|again| again.wake), None);
}

#[test]
fn calls_that_would_wait_for_ever_or_with_a_semaphore_are_refused() {
    let mut s = started(&[cyclic(1000, 0, 1)]);
    assert_eq!(at(&mut s, 0), Some(0));
    let now = Instant(0);
    assert_eq!(s.receive(ObjectId(0), now, Span::ZERO), Err(Error::Empty));
    assert_eq!(s.receive(ObjectId(0), now, Span(u64::MAX)), Err(Error::NotAllowed));
    assert_eq!(s.wait_flags(ObjectId(1), 0, true, now, Span(1)), Err(Error::NotAllowed));
    assert_eq!(s.take(ObjectId(2)), Ok(()));
    assert_eq!(s.receive(ObjectId(0), now, Span(1)), Err(Error::Ceiling));
    assert_eq!(s.wait_flags(ObjectId(1), 1, true, now, Span(1)), Err(Error::Ceiling));
    s.set_flags(ObjectId(1), 5).expect("they are flags");
    assert_eq!(s.wait_flags(ObjectId(1), 6, false, now, Span(1)), Ok(Seen::Flags(4)));
}

#[test]
fn objects_of_another_kind_program_or_number_are_none() {
    let mut s = started(&[cyclic(100, 0, 0)]);
    assert_eq!(at(&mut s, 0), Some(0));
    assert_eq!(s.object_of(PROGRAM, 3), Ok(ObjectId(3)));
    for (program, number) in [(0, 4), (0, u64::MAX), (1, 0), (7, 0)] {
        assert_eq!(s.object_of(ProgramId(program), number), Err(Error::BadId));
    }
    assert_eq!(s.take(ObjectId(0)), Err(Error::BadId));
    assert_eq!(s.send(ObjectId(1)), Err(Error::BadId));
    assert_eq!(s.set_flags(ObjectId(2), 1), Err(Error::BadId));
    assert_eq!(s.read(ObjectId(0)), Err(Error::BadId));
    // A ceiling less urgent than the task.
    assert_eq!(s.take(ObjectId(2)), Err(Error::Ceiling));
}

#[test]
fn a_value_is_new_once_to_each_task() {
    let mut s = started(&[cyclic(100, 0, 0), cyclic(100, 0, 1)]);
    assert_eq!(at(&mut s, 0), Some(0));
    assert_eq!(s.read(ObjectId(3)), Err(Error::Empty));
    assert_eq!(s.write(ObjectId(3)), Ok(()));
    assert_eq!((s.read(ObjectId(3)), s.read(ObjectId(3))), (Ok(true), Ok(false)));
    s.end(Instant(1));
    assert_eq!(at(&mut s, 1), Some(1));
    assert_eq!(s.read(ObjectId(3)), Ok(true));
}

#[test]
fn tasks_begin_when_the_initialisation_has_ended() {
    let mut s = started(&[settings(Release::Start, 255), cyclic(100, 0, 0)]);
    assert_eq!((s.phase(PROGRAM), at(&mut s, 0)), (Phase::Starting, Some(0)));
    assert_eq!(at(&mut s, 150), Some(0));
    s.end(Instant(150));
    assert_eq!(s.phase(PROGRAM), Phase::Running);
    assert_eq!((at(&mut s, 199), at(&mut s, 200)), (None, Some(1)));
    assert_eq!(s.task(TaskId(1)).elapsed(), Span::ZERO);
}

#[test]
fn an_initialisation_without_end_keeps_no_task_of_another_program_waiting() {
    let mut s = started(&[]);
    assert!(s.add_task(settings(Release::Start, 255)).is_ok());
    let other = s.add_program(core::iter::empty()).unwrap();
    assert!(s.add_task(Settings { program: other, ..cyclic(100, 0, 255) }).is_ok());
    s.start(PROGRAM, Instant(0));
    s.start(other, Instant(0));
    assert_eq!(at(&mut s, 0), Some(1));
    s.end(Instant(10));
    assert_eq!((at(&mut s, 10), at(&mut s, 100)), (Some(0), Some(1)));
}

#[test]
fn a_freewheeling_job_without_an_end_shares_the_rest_with_an_initialisation() {
    let mut s = started(&[settings(Release::Freewheeling, 0)]);
    let other = s.add_program(core::iter::empty()).unwrap();
    assert!(s.add_task(Settings { program: other, ..settings(Release::Start, 255) }).is_ok());
    s.start(other, Instant(0));
    let mut ran = [0; 2];
    for window in 0..100 {
        s.window(Instant(100 * window));
        let id = at(&mut s, 100 * window).unwrap();
        ran[usize::from(id)] += 1;
        s.account(TaskId(id), Span(30));
    }
    assert_eq!(ran, [50, 50]);
    // It comes before an initialisation without an end as soon as its next job is released.
    s.end(Instant(10_000));
    s.window(Instant(10_100));
    assert_eq!(at(&mut s, 10_100), Some(0));
}

#[test]
fn what_was_expected_of_a_job_that_is_over_is_left_out() {
    let limited = Settings { deadline: Span(280), ..cyclic(1_000, 0, 0) };
    let mut s = started(&[limited]);
    assert_eq!(at(&mut s, 0), Some(0));
    s.end(Instant(50));
    // The deadline of the job.
    assert_eq!(s.next_event(), Instant(280));
    assert_eq!((s.look_ahead(), s.next_event()), (Instant(1_000), Instant(1_000)));
}

#[test]
fn a_freewheeling_task_of_any_priority_has_what_the_others_leave() {
    let mut s = started(&[settings(Release::Freewheeling, 0), cyclic(100, 0, 255)]);
    s.window(Instant(0));
    assert_eq!(at(&mut s, 0), Some(1));
    s.end(Instant(10));
    assert_eq!((at(&mut s, 10), at(&mut s, 100)), (Some(0), Some(1)));
    s.end(Instant(110));
    // With a budget it may hold a semaphore, and runs at its ceiling then, whatever its priority is.
    for priority in [0, 9] {
        let freewheeling = settings(Release::Freewheeling, priority);
        let limited = Settings { budget: Span(500), ..freewheeling };
        let mut s = started(&[limited, cyclic(100, 0, 1), cyclic(100, 10, 0)]);
        s.window(Instant(0));
        assert_eq!(at(&mut s, 0), Some(1));
        s.end(Instant(5));
        assert_eq!((at(&mut s, 5), s.take(ObjectId(2))), (Some(0), Ok(())));
        assert_eq!(at(&mut s, 10), Some(2), "it is more urgent than the ceiling");
        s.end(Instant(20));
        assert_eq!(at(&mut s, 100), Some(0));
        assert_eq!((s.give(ObjectId(2)), at(&mut s, 101)), (Ok(()), Some(1)));
    }
}

#[test]
fn a_semaphore_lets_nothing_without_a_budget_keep_other_tasks_waiting() {
    let freewheeling = settings(Release::Freewheeling, 1);
    let mut s = started(&[freewheeling, cyclic(100, 0, 1)]);
    s.window(Instant(0));
    assert_eq!(at(&mut s, 0), Some(1));
    s.end(Instant(10));
    assert_eq!((at(&mut s, 10), s.take(ObjectId(2))), (Some(0), Err(Error::NotAllowed)));
    assert_eq!(s.take(ObjectId(0)), Err(Error::BadId));
    assert_eq!(at(&mut s, 100), Some(1));
    // An initialisation may take one, and stays behind all others' tasks with it.
    let mut s = Small::new();
    assert_eq!(s.add_program([Object::semaphore(0)].into_iter()), Ok(PROGRAM));
    let other = s.add_program(core::iter::empty()).unwrap();
    for task in [settings(Release::Start, 255), cyclic(100, 0, 0)] {
        assert!(s.add_task(task).is_ok());
    }
    assert!(s.add_task(Settings { program: other, ..cyclic(100, 0, 0) }).is_ok());
    s.start(PROGRAM, Instant(0));
    s.start(other, Instant(0));
    assert_eq!(at(&mut s, 0), Some(2));
    s.end(Instant(10));
    assert_eq!((at(&mut s, 10), s.take(ObjectId(0))), (Some(0), Ok(())));
    assert!(!s.task(TaskId(0)).is_bounded());
    assert_eq!(at(&mut s, 100), Some(2));
    s.end(Instant(110));
    // What it held is free when its program's tasks begin.
    assert_eq!(at(&mut s, 110), Some(0));
    s.end(Instant(150));
    assert_eq!(s.object_at(ObjectId(0)), Object::semaphore(0));
    assert_eq!((at(&mut s, 200), s.take(ObjectId(0))), (Some(1), Ok(())));
}

#[test]
fn no_ceiling_is_above_the_most_urgent_task_of_its_own_program() {
    let mut s = Small::new();
    assert_eq!(s.add_program([Object::semaphore(0)].into_iter()), Ok(PROGRAM));
    let other = s.add_program(core::iter::empty()).unwrap();
    // That a freewheeling task has a more urgent number means nothing.
    for task in [cyclic(100, 0, 7), cyclic(1_000, 0, 5), settings(Release::Freewheeling, 0)] {
        assert!(s.add_task(task).is_ok());
    }
    assert!(s.add_task(Settings { program: other, ..cyclic(100, 50, 4) }).is_ok());
    assert!(s.add_task(Settings { program: other, ..cyclic(100, 60, 5) }).is_ok());
    for _ in 0..2 {
        s.start(PROGRAM, Instant(0));
        s.start(other, Instant(0));
        assert_eq!(s.object_at(ObjectId(0)), Object::semaphore(5));
        assert_eq!(at(&mut s, 0), Some(1));
        s.end(Instant(10));
        assert_eq!((at(&mut s, 10), s.take(ObjectId(0))), (Some(0), Ok(())));
        assert_eq!(at(&mut s, 50), Some(3));
        s.end(Instant(55));
        assert_eq!(at(&mut s, 60), Some(0), "before all of the ceiling's priority");
        assert_eq!((s.give(ObjectId(0)), at(&mut s, 61)), (Ok(()), Some(4)));
    }
}

#[test]
fn a_failed_program_does_nothing_until_it_is_started_anew() {
    let mut s = started(&[cyclic(100, 0, 0), cyclic(100, 0, 1)]);
    assert_eq!(at(&mut s, 0), Some(0));
    s.send(ObjectId(0)).expect("there is room");
    s.fail(TaskId(0));
    assert_eq!(s.task(TaskId(0)).state(), State::Faulted);
    assert_eq!(s.task(TaskId(1)).state(), State::Dormant);
    assert_eq!(s.object_at(ObjectId(0)), Object::queue(2));
    s.signal(TaskId(0), Instant(5));
    assert_eq!((s.running(), at(&mut s, 1000)), (None, None));
    s.start(PROGRAM, Instant(1010));
    assert_eq!((at(&mut s, 1010), at(&mut s, 1100)), (None, Some(0)));
    assert_eq!(s.task(TaskId(0)).cycle(), 0);
}

#[test]
fn more_than_there_is_room_for_is_refused() {
    let mut s = Small::new();
    assert!(s.add_program((0..9).map(|_| Object::Flags(0))).is_err());
    let mut s = started(&[cyclic(1, 0, 0); 8]);
    assert!(s.add_task(cyclic(1, 0, 0)).is_err());
    assert!(s.add_program(core::iter::empty()).is_ok());
    assert!(s.add_program(core::iter::empty()).is_err());
}

#[test]
fn a_period_of_zero_and_the_end_of_time_do_no_harm() {
    let mut s = started(&[cyclic(0, 0, 0), cyclic(u64::MAX, u64::MAX, 0)]);
    at(&mut s, 1);
    s.end(Instant(1));
    at(&mut s, u64::MAX);
    s.end(Instant(u64::MAX));
    assert_ne!(s.task(TaskId(0)).state(), State::Waiting(Wait::Message(0)));
}
