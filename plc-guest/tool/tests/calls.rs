//! Calls of the kernel as `takt plc test` answers them: what the kernel gives is given here, too.

mod common;

use common::Folder;

const HEAD: &str = "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 1, 0, 0, 0);\n";

/// Runs a program for one row, in which these variables get these values.
fn expect(source: &str, values: &[(&str, i64)]) {
    let folder = Folder::new();
    let points =
        values.iter().map(|(name, _)| format!("int64_t {name}; TAKT_POINT(LINT, {name}, 0);\n"));
    folder.c_program("p", &format!("{HEAD}{}{source}", points.collect::<String>())).expect(0, "");
    let names: Vec<_> = values.iter().map(|(name, _)| *name).collect();
    let wanted: Vec<_> = values.iter().map(|(_, value)| value.to_string()).collect();
    folder.write("t.csv", &format!("{}\n{}\n", names.join(","), wanted.join(",")));
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(0, "all as expected");
}

#[test]
fn a_semaphore_is_compared_with_the_urgency_that_the_kernel_knows() {
    let source = "TAKT_SEMAPHORE(lock, 1);
        static void start(const takt_job *job) { (void)job; initial = takt_take(lock, 0); }
        TAKT_INIT(start);
        static void a(const takt_job *job) { (void)job; above = takt_take(lock, 0); }
        TAKT_CYCLIC(a, .period = TAKT_MS(1), .priority = 0);
        static void b(const takt_job *job) { (void)job; below = takt_take(lock, 0); twice = takt_take(lock, 0); }
        TAKT_CYCLIC(b, .period = TAKT_MS(1), .priority = 1);
        static void c(const takt_job *job) { (void)job; bounded = takt_take(lock, 0); }
        TAKT_FREEWHEELING(c, .priority = 0, .budget = TAKT_US(100));
        static void d(const takt_job *job) { (void)job; endless = takt_take(lock, 0); }
        TAKT_FREEWHEELING(d, .priority = 9);";
    // The initialisation and freewheeling tasks come after all others; what has no budget takes none.
    let values = [
        ("initial", 0),
        ("above", -9),
        ("below", 0),
        ("twice", -9),
        ("bounded", 0),
        ("endless", -8),
    ];
    expect(source, &values);
}

#[test]
fn what_init_has_read_is_fresh_for_the_first_task() {
    let source = "TAKT_MAILBOX(box, 4);
        static void start(const takt_job *job) {
            int32_t value = 7;
            (void)job;
            takt_mailbox_write(box, &value, sizeof value);
            initial = takt_mailbox_read(box, &value, sizeof value);
        }
        TAKT_INIT(start);
        static void a(const takt_job *job) {
            int32_t value;
            (void)job;
            first = takt_mailbox_read(box, &value, sizeof value);
            second = takt_mailbox_read(box, &value, sizeof value);
        }
        TAKT_CYCLIC(a, .period = TAKT_MS(1));";
    let fresh = (1 << 32) | 4;
    expect(source, &[("initial", fresh), ("first", fresh), ("second", 4)]);
}

#[test]
fn an_empty_message_lies_anywhere() {
    let source = "TAKT_QUEUE(jobs, 4, 1); TAKT_MAILBOX(box, 4);
        static void a(const takt_job *job) {
            char room[4];
            (void)job;
            sent = takt_send(jobs, (void *)0, 0);
            received = takt_receive(jobs, room, sizeof room, 0);
            written = takt_mailbox_write(box, (void *)0x7fffffff0000, 0);
            logged = takt_call(2, 0, 0, 0, 0);
            wild = takt_send(jobs, (void *)0, 1);
        }
        TAKT_CYCLIC(a, .period = TAKT_MS(1));";
    let values = [("sent", 0), ("received", 0), ("written", 0), ("logged", 0), ("wild", -2)];
    expect(source, &values);
}

#[test]
fn a_job_that_polls_by_calls_ends_with_its_time() {
    // The clock stands still while a job runs. The second call is one of tests in Structured Text, which no kernel has.
    for body in [
        "int64_t end = takt_time() + TAKT_US(10); while (takt_time() < end);",
        "for (;;) takt_call(0x74000001, 0, 0, 0, 0);",
    ] {
        let folder = Folder::new();
        let source = format!(
            "{HEAD}static void run(const takt_job *job) {{ (void)job; {body} }}\n\
             TAKT_CYCLIC(run, .period = TAKT_MS(1));"
        );
        folder.c_program("p", &source).expect(0, "");
        let words = ["test", "p.plc", "--time-limit", "200"];
        folder.takt_plc(&words).expect(3, "it did not end in time").expect(3, "task run, job 0");
    }
}
