//! `takt plc load`, `versions`, `commit`, `rollback`, `keep`, and `release` before them, against a socket that answers as
//! Takt does.

mod common;

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixListener;
use std::thread;

use common::{Ended, Folder};
use takt_program::build::{Builder, Task, Variable};
use takt_program::{Area, CodeOffset, Elementary, Image, Nanoseconds, signature};

/// A program `tank` with this code.
fn builder(code: u8) -> Builder {
    builder_of("tank", code)
}

fn builder_of(program: &str, code: u8) -> Builder {
    let mut image = Builder::new(program);
    image.code = vec![code, 0xc3];
    let mut task = Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0));
    task.budget = Some(Nanoseconds(10_000));
    image.task(task);
    image
}

/// A folder with a partition file and the image of its program `tank`.
fn plant() -> Folder {
    let folder = Folder::new();
    fs::write(folder.path().join("tank.plc"), builder(0xc3).build().unwrap()).unwrap();
    let text = "version = 1\n[system]\nname = \"s\"\nmajor_frame = \"1ms\"\ncontrol = \"s\"\n\
        [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"8MiB\"\n\
        [[partition.program]]\nimage = \"tank.plc\"\n[[schedule]]\nname = \"normal\"\n\
        [[schedule.window]]\npartition = \"plc\"\noffset = \"0us\"\nduration = \"300us\"\n";
    folder.write("plant.toml", text);
    folder
}

fn versions(phase: &str) -> String {
    stand(&"7a".repeat(32), &"7a".repeat(32), phase)
}

/// Versions 1.2.0, which runs, and 1.3.0 with these hashes.
fn stand(running: &str, other: &str, phase: &str) -> String {
    let image = |version, hash| format!("{{\"version\":\"{version}\",\"hash\":\"{hash}\"}}");
    format!(
        "{{\"version\":2,\"answer\":\"versions\",\"versions\":[{{\"program\":\"tank\",\"running\":{},\"other\":{},\
         \"phase\":\"{phase}\",\"reason\":null,\"jobs\":0,\"references_gone\":0,\"took_ns\":0,\"at_ns\":0,\"cycle\":0}}]}}",
        image("1.2.0", running),
        image("1.3.0", other)
    )
}

/// Runs the command with a Takt that gives these answers; what was asked of it, and what the command did.
fn run(words: &[&str], answers: &[String]) -> (Vec<String>, Ended) {
    run_in(&plant(), words, answers)
}

/// [`run()`] in such a folder.
fn run_in(folder: &Folder, words: &[&str], answers: &[String]) -> (Vec<String>, Ended) {
    run_while(folder, words, answers, |_| {})
}

/// [`run_in()`], and does this with each request before it is answered.
fn run_while(
    folder: &Folder,
    words: &[&str],
    answers: &[String],
    on_request: impl Fn(&str) + Send + 'static,
) -> (Vec<String>, Ended) {
    let _ = fs::remove_file(folder.path().join("s"));
    let listener = UnixListener::bind(folder.path().join("s")).unwrap();
    let answers = answers.to_vec();
    let takt = thread::spawn(move || {
        let mut asked = Vec::new();
        let (stream, _) = listener.accept().unwrap();
        let mut lines = BufReader::new(stream.try_clone().unwrap()).lines();
        for answer in answers {
            let Some(Ok(line)) = lines.next() else { break };
            on_request(&line);
            asked.push(line);
            writeln!(&stream, "{answer}").unwrap();
        }
        asked
    });
    let ended = folder.takt_plc(words);
    (takt.join().unwrap(), ended)
}

fn done() -> String {
    "{\"version\":2,\"answer\":\"done\",\"text\":\"taken\"}".to_owned()
}

#[test]
fn load_sends_the_image_and_waits_until_it_is_prepared() {
    let answers = [done(), versions("preparing"), versions("preparing"), versions("prepared")];
    let folder = plant();
    let (asked, ended) = run_in(&folder, &["load", "plant.toml", "tank", "tank.plc"], &answers);
    ended.expect(0, "runs 1.2.0 (7a7a7a7a), other 1.3.0 (7a7a7a7a), prepared");
    let read = |name| fs::read(folder.path().join(name)).unwrap();
    assert!(read("tank.plc.loaded") == read("tank.plc"));
    assert!(asked[0].contains("\"request\":\"load\"") && asked[0].contains("\"parts\":1"));
    assert_eq!(asked.len(), 4);
}

#[test]
fn an_image_that_cannot_be_read_is_a_bad_file() {
    let folder = plant();
    folder.write("empty.plc", "");
    for (image, says) in [("empty.plc", "the file is empty"), ("none.plc", "cannot read none.plc")]
    {
        folder.takt_plc(&["load", "plant.toml", "tank", image]).expect(2, says);
    }
}

/// A build may replace the file while the kernel prepares the version.
#[test]
fn the_next_start_begins_with_the_bytes_that_were_sent() {
    let folder = plant();
    let sent = folder.read("tank.plc");
    let file = folder.path().join("next.plc");
    fs::write(&file, &sent).unwrap();
    let answers = [done(), versions("prepared")];
    let replace = move |asked: &str| {
        if asked.contains("\"request\":\"versions\"") {
            fs::write(&file, image(0x90).0).unwrap();
        }
    };
    let words = ["load", "plant.toml", "tank", "next.plc"];
    run_while(&folder, &words, &answers, replace).1.expect(0, "prepared");
    assert!(folder.read("tank.plc.loaded") == sent);
}

#[test]
fn an_order_tells_what_came_of_it() {
    for (order, request, phase, status) in [
        ("commit", "commit", "trial", 0),
        ("commit", "commit", "rolled-back", 5),
        ("commit", "commit", "prepared", 5),
        ("rollback", "roll-back", "rolled-back", 0),
        ("roll-back", "roll-back", "none", 0),
        ("rollback", "roll-back", "held", 5),
    ] {
        // Before a roll-back the client asks how the versions stand.
        let (during, before) = match request {
            "commit" => ("committing", vec![]),
            _ => ("rolling-back", vec![versions("held")]),
        };
        let rest = [done(), versions(during), versions(phase)];
        let (place, answers) = (before.len(), [before, rest.to_vec()].concat());
        let (asked, ended) = run(&[order, "plant.toml", "tank", "--until-restart"], &answers);
        ended.expect(status, phase);
        assert!(asked[place].contains(&format!("\"request\":\"{request}\"")), "{asked:?}");
    }
}

#[test]
fn a_roll_back_after_which_the_new_version_runs_has_failed() {
    let ((new, new_hash), folder) = (image(0x90), plant());
    let old = fs::read(folder.path().join("tank.plc")).unwrap();
    let old_hash = hash_of(&old);
    let write = |name: &str, bytes: &[u8]| fs::write(folder.path().join(name), bytes).unwrap();
    let words = ["rollback", "plant.toml", "tank"];
    // Takt learns only with the order that the program has stopped, and that the kernel has forgotten the way back.
    for phase in ["trial", "held"] {
        let answers = [
            stand(&new_hash, &old_hash, phase),
            done(),
            stand(&new_hash, &old_hash, "rolling-back"),
            stand(&new_hash, &old_hash, "none"),
        ];
        let says = "did not come back";
        write("tank.plc", &old);
        let ended = run_in(&folder, &words, &answers).1.expect(5, says);
        ended.expect(5, "tank.plc; else, start Takt anew, which begins with it");
        write("tank.plc", &new);
        let ended = run_in(&folder, &words, &answers).1.expect(5, says);
        ended.expect(5, "`takt plc load` and `commit` its image; else, put it in the place of");
        write("tank.plc.previous", &old);
        let ended = run_in(&folder, &words, &answers).1.expect(5, says);
        ended.expect(5, "tank.plc.previous");
        let restart = [&words[..], &["--until-restart"]].concat();
        run_in(&folder, &restart, &answers).1.expect(5, says);
        assert!(fs::read(folder.path().join("tank.plc")).unwrap() == new);
        fs::remove_file(folder.path().join("tank.plc.previous")).unwrap();
    }
    // The guest can start anew with the version before.
    write("tank.plc.previous", &old);
    let answers =
        [stand(&new_hash, &old_hash, "held"), done(), stand(&old_hash, &old_hash, "none")];
    run_in(&folder, &words, &answers).1.expect(0, "tank.plc is version 0.0.0 (");
    assert!(fs::read(folder.path().join("tank.plc")).unwrap() == old);
}

#[test]
fn a_version_that_was_not_entered_is_given_up_when_takt_has_heard_it() {
    let words = ["rollback", "plant.toml", "tank"];
    for phase in ["preparing", "prepared", "committing"] {
        let answers = [versions(phase), done(), versions(phase), versions(phase), versions("none")];
        run(&words, &answers).1.expect(0, "none");
    }
    // A commit can be faster than the order to take it back.
    let [old, new] = ["7a", "5e"].map(|digits| digits.repeat(32));
    let before = stand(&old, &new, "committing");
    let entered = [before.clone(), done(), before, stand(&new, &old, "none")];
    run(&words, &entered).1.expect(5, "did not come back");
}

#[test]
fn what_is_refused_or_not_there_ends_with_its_status() {
    let refusal = r#"{"version":2,"answer":"error","error":"refused","text":"no version is prepared (none)"}"#;
    let answers = [versions("none"), refusal.to_owned()];
    let (_, ended) = run(&["commit", "plant.toml", "tank"], &answers);
    ended.expect(5, "no version is prepared (none)");
    let plant = plant();
    plant
        .takt_plc(&["commit", "plant.toml", "press"])
        .expect(2, "no program is named `press`; there are tank");
    plant.takt_plc(&["versions", "plant.toml"]).expect(6, "no Takt at");
}

#[test]
fn all_values_are_released_whatever_version_runs() {
    // Only the order is answered: what runs is not asked.
    let (asked, ended) = run(&["release", "plant.toml", "--all"], &[done()]);
    ended.expect(0, "taken");
    assert!(asked[0].contains("\"request\":\"release\""), "{asked:?}");
}

#[test]
fn versions_shows_each_program() {
    let (_, ended) = run(&["versions", "plant.toml"], &[versions("held")]);
    ended.expect(0, "other 1.3.0 (7a7a7a7a), held");
}

/// Versions of `tank` of which one with this hash runs.
fn running(hash: &str, phase: &str) -> String {
    versions(phase).replacen(&"7a".repeat(32), hash, 1)
}

/// The image of a `tank` with this code, and its hash.
fn image(code: u8) -> (Vec<u8>, String) {
    let bytes = builder(code).build().unwrap();
    let hash = hash_of(&bytes);
    (bytes, hash)
}

fn hash_of(image: &[u8]) -> String {
    let hash = Image::verify(image).unwrap().hash();
    hash.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn what_runs_is_kept_for_the_next_start_when_its_trial_is_over() {
    let (new, hash) = image(0x90);
    let old = fs::read(plant().path().join("tank.plc")).unwrap();
    let answers = [running(&hash, "trial"), running(&hash, "held")];
    let words = ["keep", "plant.toml", "tank", "new.plc"];
    let folder = plant();
    fs::write(folder.path().join("new.plc"), &new).unwrap();
    let (_, ended) = run_in(&folder, &words, &answers);
    ended.expect(0, "tank.plc is version 0.0.0 (").expect(0, "the one before it is ");
    let read = |name| fs::read(folder.path().join(name)).unwrap();
    assert!(read("tank.plc") == new && read("tank.plc.previous") == old);
    let (_, ended) = run_in(&folder, &words, &answers[1..]);
    ended.expect(0, "already");
    assert!(read("tank.plc.previous") == old);
}

#[test]
fn the_next_start_begins_with_what_was_committed_and_after_a_roll_back_with_what_was_before() {
    let ((new, new_hash), folder) = (image(0x90), plant());
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    let (old, old_hash) = (read("tank.plc"), hash_of(&read("tank.plc")));
    fs::write(folder.path().join("tank.plc.loaded"), &new).unwrap();
    let commit = ["commit", "plant.toml", "tank"];
    // A version that fails its trial is not kept, and a commit waits for that.
    let phases = |hash: &str, phases: &[&str]| -> Vec<String> {
        let answers = phases.iter().map(|phase| running(hash, phase));
        [done()].into_iter().chain(answers).collect()
    };
    let prepared = [stand(&old_hash, &new_hash, "prepared")];
    let fails = phases(&new_hash, &["committing", "trial", "rolled-back"]);
    let (_, ended) = run_in(&folder, &commit, &[&prepared[..], &fails].concat());
    ended.expect(5, "tank is now rolled-back");
    assert!(read("tank.plc") == old);
    let held = phases(&new_hash, &["committing", "trial", "trial", "held"]);
    let (_, ended) = run_in(&folder, &[&commit[..], &["--until-restart"]].concat(), &held);
    ended.expect(0, "trial");
    assert!(read("tank.plc") == old);
    let (_, ended) = run_in(&folder, &commit, &[&prepared[..], &held].concat());
    ended.expect(0, "held").expect(0, "tank.plc is version 0.0.0 (");
    assert!(read("tank.plc") == new && read("tank.plc.previous") == old);

    let back = [
        stand(&new_hash, &old_hash, "held"),
        done(),
        stand(&new_hash, &old_hash, "rolling-back"),
        stand(&old_hash, &new_hash, "rolled-back"),
    ];
    let (_, ended) = run_in(&folder, &["rollback", "plant.toml", "tank"], &back);
    ended.expect(0, "tank.plc is version 0.0.0 (");
    assert!(read("tank.plc") == old && read("tank.plc.previous") == new);

    // What is given up before it was entered changes nothing.
    let prepared = running(&new_hash, "prepared");
    let none = [prepared, done(), running(&new_hash, "none")];
    run_in(&folder, &["rollback", "plant.toml", "tank"], &none).1.expect(0, "none");
    assert!(read("tank.plc") == old);
}

#[test]
fn a_commit_tells_if_no_start_would_begin_with_it() {
    let ((mut new, hash), folder) = (image(0x90), plant());
    *new.last_mut().unwrap() ^= 1;
    let old = fs::read(folder.path().join("tank.plc")).unwrap();
    for end in ["loaded", "previous"] {
        fs::write(folder.path().join("tank.plc").with_extension(format!("plc.{end}")), &new)
            .unwrap();
    }
    let answers = [versions("prepared"), done(), running(&hash, "held")];
    let (_, ended) = run_in(&folder, &["commit", "plant.toml", "tank"], &answers);
    ended.expect(5, "the next start begins with").expect(5, "`takt plc keep` puts the image");
    assert!(fs::read(folder.path().join("tank.plc")).unwrap() == old);
}

/// A folder in which the partition file connects an input `level` of `tank`, and the image of a version without it.
fn plant_with_an_input() -> (Folder, Vec<u8>) {
    let folder = plant();
    let mut image = builder(0xc3);
    image.input_bytes = 8;
    let ty = image.elementary(Elementary::Lreal);
    image.variable(Variable::new("level", ty, Area::Input, 0));
    fs::write(folder.path().join("tank.plc"), image.build().unwrap()).unwrap();
    let mut without = builder(0x90);
    without.input_bytes = 8;
    let text = fs::read_to_string(folder.path().join("plant.toml")).unwrap();
    let io =
        "[[partition.io]]\npoint = \"level\"\nsimulate = { shape = \"constant\", value = 1 }\n";
    folder.write("plant.toml", &text.replace("[[schedule]]", &format!("{io}[[schedule]]")));
    (folder, without.build().unwrap())
}

#[test]
fn a_version_with_which_the_partition_file_does_not_pass_is_not_put_in_place() {
    let (folder, new) = plant_with_an_input();
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    let old = read("tank.plc");
    let [old_hash, new_hash] = [&old, &new].map(|image| hash_of(image));
    let error = "the program has no variable \"level\"";
    fs::write(folder.path().join("new.plc"), &new).unwrap();
    let load = ["load", "plant.toml", "tank", "new.plc"];
    let (_, ended) = run_in(&folder, &load, &[done(), versions("prepared")]);
    ended.expect(0, "the next start cannot begin with it").expect(0, error);
    assert!(read("tank.plc.loaded") == new);

    // Nothing has been ordered when the commit is refused.
    let commit = ["commit", "plant.toml", "tank"];
    let prepared = stand(&old_hash, &new_hash, "prepared");
    let held = stand(&new_hash, &old_hash, "held");
    let (asked, ended) = run_in(&folder, &commit, std::slice::from_ref(&prepared));
    ended.expect(5, "nothing is ordered").expect(5, error).expect(5, "--until-restart");
    assert!(asked.len() == 1 && asked[0].contains("\"request\":\"versions\""), "{asked:?}");
    let (_, ended) =
        run_in(&folder, &[&commit[..], &["--until-restart"]].concat(), &[done(), held.clone()]);
    ended.expect(0, "held");
    // What has been entered all the same is not kept.
    let keep = ["keep", "plant.toml", "tank", "new.plc"];
    let (_, ended) = run_in(&folder, &keep, std::slice::from_ref(&held));
    ended.expect(5, "runs until the next start, and ").expect(5, error);
    assert!(read("tank.plc") == old && !folder.path().join("tank.plc.previous").exists());

    // When the partition file is changed it is.
    let text = String::from_utf8(read("plant.toml")).unwrap();
    let (begin, end) = (text.find("[[partition.io]]").unwrap(), text.find("[[schedule]]").unwrap());
    folder.write("plant.toml", &(text[..begin].to_owned() + &text[end..]));
    let answers = [prepared, done(), held];
    run_in(&folder, &commit, &answers).1.expect(0, "tank.plc is version 0.0.0 (");
    assert!(read("tank.plc") == new);

    // A way back is taken whatever the file says.
    folder.write("plant.toml", &text.replace("\"level\"", "\"later\""));
    let mut later = builder(0x90);
    later.input_bytes = 8;
    let ty = later.elementary(Elementary::Lreal);
    later.variable(Variable::new("later", ty, Area::Input, 0));
    let later = later.build().unwrap();
    fs::write(folder.path().join("tank.plc"), &later).unwrap();
    fs::write(folder.path().join("tank.plc.previous"), &new).unwrap();
    let answers = [
        stand(&hash_of(&later), &new_hash, "held"),
        done(),
        stand(&new_hash, &hash_of(&later), "rolled-back"),
    ];
    let (_, ended) = run_in(&folder, &["rollback", "plant.toml", "tank"], &answers);
    ended.expect(5, "rolled-back").expect(5, "runs until the next start, and ");
    assert!(read("tank.plc") == later && read("tank.plc.previous") == new);
}

#[test]
fn an_image_that_two_programs_begin_with_is_not_replaced() {
    let (folder, (new, new_hash)) = (plant(), image(0x90));
    let old = fs::read(folder.path().join("tank.plc")).unwrap();
    let text = fs::read_to_string(folder.path().join("plant.toml")).unwrap();
    std::os::unix::fs::symlink("tank.plc", folder.path().join("link.plc")).unwrap();
    fs::write(folder.path().join("new.plc"), &new).unwrap();
    fs::write(folder.path().join("tank.plc.loaded"), &new).unwrap();
    let commit = ["commit", "plant.toml", "tank"];
    let keep = ["keep", "plant.toml", "tank", "new.plc"];
    let prepared = stand(&hash_of(&old), &new_hash, "prepared");
    let held = running(&new_hash, "held");
    for image in ["tank.plc", "link.plc"] {
        let press = format!("[[partition.program]]\nname = \"press\"\nimage = \"{image}\"\n");
        folder.write("plant.toml", &text.replace("[[schedule]]", &(press + "[[schedule]]")));
        let (asked, ended) = run_in(&folder, &commit, std::slice::from_ref(&prepared));
        let says = "tank.plc is the image of press in the partition plc too";
        ended.expect(5, "nothing is ordered").expect(5, says).expect(5, "copy the file");
        assert_eq!(asked.len(), 1);
        let (_, ended) = run_in(&folder, &keep, std::slice::from_ref(&held));
        ended.expect(5, says);
        assert!(fs::read(folder.path().join("tank.plc")).unwrap() == old);
        // What is there already changes nothing.
        let words = ["load", "plant.toml", "press", image];
        let answers = [done(), versions("prepared").replace("tank", "press")];
        let ended = run_in(&folder, &words, &answers).1.expect(0, "prepared");
        assert!(!ended.text.contains("cannot begin"), "{}", ended.text);
        fs::write(folder.path().join("tank.plc.loaded"), &new).unwrap();
    }
    fs::remove_file(folder.path().join("link.plc")).unwrap();
    fs::write(folder.path().join("link.plc"), &old).unwrap();
    run_in(&folder, &keep, &[held]).1.expect(0, "tank.plc is version 0.0.0 (");
}

#[test]
fn a_version_with_another_name_does_not_change_that_of_the_program() {
    let (press, folder) = (builder_of("press", 0x90).build().unwrap(), plant());
    fs::write(folder.path().join("press.plc"), &press).unwrap();
    let keep = ["keep", "plant.toml", "tank", "press.plc"];
    let held = [running(&hash_of(&press), "held")];
    let (_, ended) = run_in(&folder, &keep, &held);
    ended.expect(5, "the program would be named press then").expect(5, "`name = \"tank\"`");
    let text = fs::read_to_string(folder.path().join("plant.toml")).unwrap();
    folder.write("plant.toml", &text.replace("image =", "name = \"tank\"\nimage ="));
    run_in(&folder, &keep, &held).1.expect(0, "tank.plc is version 0.0.0 (");
}

#[test]
fn what_does_not_run_or_no_start_would_take_is_not_kept() {
    let (new, _) = image(0x90);
    let words = ["keep", "plant.toml", "tank", "new.plc"];
    let folder = plant();
    let old = fs::read(folder.path().join("tank.plc")).unwrap();
    fs::write(folder.path().join("new.plc"), &new).unwrap();
    let (_, ended) = run_in(&folder, &words, &[running(&"7a".repeat(32), "rolled-back")]);
    ended.expect(2, "version 1.2.0 (7a7a7a7a) of tank runs");
    let mut image = new.clone();
    *image.last_mut().unwrap() ^= 1;
    fs::write(folder.path().join("new.plc"), image).unwrap();
    folder.takt_plc(&words).expect(2, "new.plc: ");
    fs::write(folder.path().join("new.plc"), &new).unwrap();
    let text = fs::read_to_string(folder.path().join("plant.toml")).unwrap();
    // A partition file with keys is not read at all while its image is not signed.
    let key = signature::public(&[3; 32]).iter().map(|b| format!("{b:02x}")).collect::<String>();
    let mut signed = old.clone();
    signature::sign(&mut signed, &[3; 32]).unwrap();
    fs::write(folder.path().join("tank.plc"), &signed).unwrap();
    folder.write(
        "plant.toml",
        &text.replace("[[schedule]]", &format!("keys = [\"{key}\"]\n[[schedule]]")),
    );
    folder.takt_plc(&words).expect(2, "new.plc is signed by none of the keys");
    assert!(fs::read(folder.path().join("tank.plc")).unwrap() == signed);
    assert!(!folder.path().join("tank.plc.previous").exists());
}
