//! The programs of a PLC: what of their images and keys is taken, what is refused, and in which words.

mod admission;
mod events;
mod images;
mod placing;
mod points;
mod refused;
mod retained;
mod shown;
mod tasks;
mod types;

#[path = "../guest_images/mod.rs"]
mod guest_images;

use std::fs;
use std::path::PathBuf;

use takt_plan::{PartitionFile, load};

/// A folder with images, and the text of one partition with programs.
struct Case {
    folder: PathBuf,
    partition: String,
    /// The windows' offset, duration and period in us.
    windows: [u64; 3],
    rest: String,
}

impl Case {
    /// With a guest that takes 4 KiB at 1 MiB, and windows of 200 us in each ms.
    fn new(name: &str) -> Case {
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("programs").join(name);
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("guest"), guest_images::plc()).unwrap();
        Case { folder, partition: String::new(), windows: [100, 200, 1000], rest: String::new() }
    }

    /// With this file in the folder.
    fn file(self, name: &str, bytes: &[u8]) -> Case {
        fs::write(self.folder.join(name), bytes).unwrap();
        self
    }

    /// With these lines in the partition.
    fn with(mut self, lines: &str) -> Case {
        self.partition.push_str(lines);
        self.partition.push('\n');
        self
    }

    /// With windows of this offset, duration and period in us.
    fn windows(self, windows: [u64; 3]) -> Case {
        Case { windows, ..self }
    }

    /// With these lines at the end of the file.
    fn ending(self, rest: &str) -> Case {
        Case { rest: rest.to_owned(), ..self }
    }

    /// With a program of this image and these keys.
    fn program(self, image: &str, keys: &str) -> Case {
        self.with(&format!("[[partition.program]]\nimage = \"{image}\"\n{keys}"))
    }

    fn load(&self) -> Result<PartitionFile, String> {
        let path = self.folder.join("case.toml");
        let [offset, duration, period] = self.windows;
        let text = format!(
            "version = 1\n[system]\nname = \"s\"\nmajor_frame = \"1ms\"\n\
             [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"16MiB\"\n\
             image = \"guest\"\n{}\n\
             [[schedule]]\nname = \"normal\"\n[[schedule.window]]\npartition = \"plc\"\n\
             offset = \"{offset}us\"\nduration = \"{duration}us\"\nperiod = \"{period}us\"\n{}",
            self.partition, self.rest
        );
        fs::write(&path, text).unwrap();
        load(&path, None).map_err(|error| error.to_string())
    }

    fn good(&self) -> PartitionFile {
        self.load().unwrap_or_else(|error| panic!("{error}"))
    }

    /// The message, which shows a place and what is allowed, and has all of these words.
    fn refused(&self, words: &[&str]) {
        let message = self.load().expect_err("a file that is refused");
        assert!(message.contains('^') && message.contains(" = allowed: "), "{message}");
        for word in words {
            assert!(message.contains(word), "no {word:?} in\n{message}");
        }
    }
}
