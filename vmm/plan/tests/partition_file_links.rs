//! A file that has two names is one file: what is written to has no other use, whatever it is called.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;

use takt_plan::load;

/// The message for a file whose channel is recorded in `record`, and whose console is kept in `log`.
fn message(folder: &Path, record: &str, log: &str) -> Option<String> {
    let path = folder.join("case.toml");
    let text = format!(
        "version = 1\n[system]\nname = \"s\"\nmajor_frame = \"1ms\"\n\
         [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"4MiB\"\n\
         console_log = \"{log}\"\n\
         [[channel]]\nname = \"levels\"\nkind = \"queuing\"\nmessage_bytes = 8\n\
         source = \"plc:levels\"\ndestinations = [\"host:levels\"]\ndepth = 8\nhost_file = \"{record}\"\n\
         [[schedule]]\nname = \"normal\"\n[[schedule.window]]\npartition = \"plc\"\n\
         offset = \"100us\"\nduration = \"200us\"\n"
    );
    fs::write(&path, text).unwrap();
    load(&path, None).err().map(|error| error.to_string())
}

fn refused(folder: &Path, record: &str, log: &str, other: &str) {
    let message = message(folder, record, log).expect("a file that is refused");
    assert!(message.contains(&format!(" is also {other}\n")), "{message}");
    assert!(
        message.contains('^') && message.contains(" = allowed: a path of its own"),
        "{message}"
    );
}

#[test]
fn two_names_of_a_file_are_one_file() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    fs::write(folder.join("old"), "").unwrap();
    fs::hard_link(folder.join("old"), folder.join("hard")).unwrap();
    symlink("old", folder.join("soft")).unwrap();
    let log = "the console's file of partition \"plc\"";
    refused(folder, "hard", "old", log);
    refused(folder, "soft", "old", log);
    refused(folder, "soft", "hard", log);
    symlink("case.toml", folder.join("itself")).unwrap();
    refused(folder, "new", "itself", "the partition file");
    assert_eq!(message(folder, "new", "old"), None);
}

#[test]
fn a_file_that_is_still_to_be_made_has_one_name_in_each_folder() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    fs::create_dir(folder.join("logs")).unwrap();
    symlink("logs", folder.join("same")).unwrap();
    refused(folder, "same/new", "logs/new", "the console's file of partition \"plc\"");
    assert_eq!(message(folder, "same/new", "logs/newer"), None);
    // Without their folders they are compared as they are written.
    refused(folder, "no/such/new", "no/./such/new", "the console's file of partition \"plc\"");
    assert_eq!(message(folder, "no/such/new", "no/new"), None);
}
