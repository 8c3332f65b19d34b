//! Partition files for tests.

use std::fmt::Write;
use std::fs;
use std::path::PathBuf;

use crate::{Outcome, Run, initrd_and, scratch, target};

/// What Linux executes where a test wants it busy: it never idles, in kernel and user mode.
pub const BUSY: &str = "while :; do cat /proc/kallsyms > /dev/null; done";

/// Command line of a Linux whose start is not what a test is about. The kernel's tests of its own cryptography take half of its
/// start in the lab, and two parts of it that nothing here uses a twentieth. The files of `configs` start it with all that.
pub const SOON: &str =
    "console=ttyS0 cryptomgr.notests initcall_blacklist=init_kprobe_trace,cubictcp_register";

/// A partition file that grows. Everything is on CPU 0, unless a CPU is named.
#[derive(Clone, Debug)]
pub struct File {
    text: String,
}

impl File {
    /// An empty one.
    #[must_use]
    pub fn new(major_frame: &str) -> Self {
        let text =
            format!("version = 1\n[system]\nname = \"test\"\nmajor_frame = {major_frame:?}\n");
        Self { text }
    }

    /// Lets takt serve the host's watchdog. Before the first partition.
    #[must_use]
    pub fn watchdog(self, time: &str) -> Self {
        self.lines(&format!("watchdog = {time:?}"))
    }

    /// Adds a PLC; `None` for the built-in image. `more` are further lines of its table.
    #[must_use]
    pub fn plc(self, name: &str, image: Option<PathBuf>, more: &str) -> Self {
        let image = image.map_or(String::new(), |path| format!("image = {path:?}\n"));
        self.plc_on(0, name, &format!("{image}{more}"))
    }

    /// Adds a PLC on a CPU. `more` are further lines of its table.
    #[must_use]
    pub fn plc_on(mut self, cpu: u32, name: &str, more: &str) -> Self {
        // Writing to a String cannot fail.
        let _ = write!(
            self.text,
            "[[partition]]\nname = {name:?}\nkind = \"plc\"\ncpu = {cpu}\nmemory = \"4MiB\"\n{more}\n"
        );
        self
    }

    /// Adds a PLC on CPU 0 with all the other lines of its table.
    #[must_use]
    pub fn plc_with(mut self, name: &str, lines: &str) -> Self {
        // Writing to a String cannot fail.
        let _ =
            write!(self.text, "[[partition]]\nname = {name:?}\nkind = \"plc\"\ncpu = 0\n{lines}\n");
        self
    }

    /// Adds Linux in the background, with commands that it executes before it gives a shell.
    #[must_use]
    pub fn linux(self, exec: &str) -> Self {
        self.other_linux(&System { exec, ..System::default() })
    }

    /// Adds Linux in the background with the programs of an initial RAM disk of
    /// [`initrd_with`](crate::initrd_with).
    #[must_use]
    pub fn linux_with(self, initrd: &str, exec: &str) -> Self {
        self.other_linux(&System { initrd, exec, ..System::default() })
    }

    /// Adds Linux in the background that compiles until the end; [`Outcome::compiled`] says how far it
    /// came. These commands come first.
    ///
    /// # Panics
    /// Without what `scripts/load-image` makes.
    #[must_use]
    pub fn compiling_linux(self, commands: &str) -> Self {
        let compiler = fs::read(target("guest/load.cpio")).expect("scripts/load-image has run");
        let initrd = initrd_and("load-initrd", &compiler);
        let exec = format!("{commands}takt-load compile");
        self.other_linux(&System {
            initrd: &initrd,
            memory: "448MiB",
            exec: &exec,
            ..System::default()
        })
    }

    /// Adds Linux in the background with stress-ng beside what it executes: `takt-load stress` is the load.
    ///
    /// # Panics
    /// Without what `scripts/load-image` makes.
    #[must_use]
    pub fn stressed_linux(self, name: &str, exec: &str) -> Self {
        let stress = fs::read(target("guest/stress.cpio")).expect("scripts/load-image has run");
        let initrd = initrd_and(&format!("{name}-initrd"), &stress);
        // In 128 MiB its kernel has no room to unpack all of that.
        self.other_linux(&System { initrd: &initrd, memory: "256MiB", exec, ..System::default() })
    }

    /// Adds a Linux in the background as it is described.
    #[must_use]
    pub fn other_linux(mut self, linux: &System<'_>) -> Self {
        let System { name, kernel, initrd, memory, exec, .. } = linux;
        let exec = match *exec {
            "" => String::new(),
            commands => format!(" takt.exec=\\\"{commands}\\\""),
        };
        let _ = writeln!(
            self.text,
            "[[partition]]\nname = {name:?}\nkind = \"linux\"\ncpu = 0\nbackground = true\n\
             memory = {memory:?}\nkernel = {:?}\ninitrd = {:?}\ncmdline = \"{SOON}{exec}\"",
            target(kernel),
            target(initrd),
        );
        self
    }

    /// Lets each Linux so far have windows instead of what they leave.
    #[must_use]
    pub fn in_windows(mut self) -> Self {
        self.text = self.text.replace("background = true\n", "");
        self
    }

    /// Adds words to the kernel's command line of each Linux so far.
    #[must_use]
    pub fn words(mut self, words: &str) -> Self {
        self.text = self.text.replace("console=ttyS0", &format!("console=ttyS0 {words}"));
        self
    }

    /// Adds lines to the last table.
    #[must_use]
    pub fn lines(mut self, lines: &str) -> Self {
        let _ = writeln!(self.text, "{lines}");
        self
    }

    /// Adds an action of the health monitor.
    #[must_use]
    pub fn health(self, partition: &str, error: &str, action: &str) -> Self {
        self.lines(&format!(
            "[[health]]\npartition = {partition:?}\nerror = {error:?}\naction = {action:?}"
        ))
    }

    /// Adds a sampling and a queuing channel for records of 512 bytes, as `peer` has them: from
    /// `out` and `send` of one partition to `in` and `receive` of the other.
    #[must_use]
    pub fn channels(mut self, from: &str, to: &str) -> Self {
        // Writing to a String cannot fail.
        let _ = write!(
            self.text,
            "[[channel]]\nname = \"state-of-{from}\"\nkind = \"sampling\"\nmessage_bytes = 512\n\
             source = \"{from}:out\"\ndestinations = [\"{to}:in\"]\nrefresh_period = \"2ms\"\n\
             [[channel]]\nname = \"orders-of-{from}\"\nkind = \"queuing\"\nmessage_bytes = 512\n\
             source = \"{from}:send\"\ndestinations = [\"{to}:receive\"]\ndepth = 4\n"
        );
        self
    }

    /// Adds a schedule.
    #[must_use]
    pub fn schedule(mut self, name: &str) -> Self {
        let _ = writeln!(self.text, "[[schedule]]\nname = {name:?}");
        self
    }

    /// Adds a window to the last schedule; times in us.
    #[must_use]
    pub fn window(mut self, partition: &str, offset: u64, duration: u64) -> Self {
        let _ = writeln!(
            self.text,
            "[[schedule.window]]\npartition = {partition:?}\noffset = \"{offset}us\"\nduration = \"{duration}us\""
        );
        self
    }

    /// Writes it, under the name of the test, and returns its path.
    #[must_use]
    pub fn save(&self, name: &str) -> PathBuf {
        let path = scratch().join(format!("{name}.toml"));
        fs::write(&path, &self.text).expect("the partition file can be written");
        // Not every folder of a path with dots exists where only the file is taken along.
        path.canonicalize().expect("the file is there")
    }

    /// A run of it, under the name of the test.
    #[must_use]
    pub fn run<'a>(&self, name: &str) -> Run<'a> {
        Run::of_text(name, &self.text)
    }
}

/// The usual system: a PLC with a window of 300 us in 1 ms, and Linux in the background.
#[derive(Clone, Debug)]
pub struct System<'a> {
    /// Image of the PLC; `None` for the built-in one.
    pub plc: Option<PathBuf>,
    /// Name of Linux.
    pub name: &'a str,
    /// Kernel of Linux, below `target/`.
    pub kernel: &'a str,
    /// Initial RAM disk, below `target/`.
    pub initrd: &'a str,
    /// Memory of Linux.
    pub memory: &'a str,
    /// Commands that Linux executes before it gives a shell.
    pub exec: &'a str,
}

impl Default for System<'_> {
    fn default() -> Self {
        Self {
            plc: None,
            name: "linux",
            kernel: "guest/vmlinuz",
            initrd: "guest/initrd.img",
            memory: "128MiB",
            exec: "",
        }
    }
}

impl System<'_> {
    fn file(&self) -> File {
        File::new("1ms")
            .plc("plc", self.plc.clone(), "release_guard = \"10us\"")
            .other_linux(self)
            .schedule("normal")
            .window("plc", 0, 300)
    }

    /// Runs it for a time, without input at the console.
    #[must_use]
    pub fn run(&self, name: &str, duration: &str) -> Outcome {
        self.file().run(name).lasting(duration).run()
    }

    /// Runs it until the console has shown a text: see [`Run::until`].
    #[must_use]
    pub fn run_until(&self, name: &str, text: &str) -> Outcome {
        self.file().run(name).lasting("60s").until(text).run()
    }

    /// Runs it with somebody who types: each text after the console has shown another.
    #[must_use]
    pub fn run_typing(
        &self,
        name: &str,
        duration: Option<&str>,
        dialogue: &[(&str, &str)],
    ) -> Outcome {
        let run = self.file().run(name).typing(dialogue);
        match duration {
            Some(duration) => run.lasting(duration).run(),
            None => run.run(),
        }
    }
}
