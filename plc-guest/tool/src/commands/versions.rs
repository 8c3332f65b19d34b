//! `takt plc load`, `versions`, `commit`, `rollback`: another version of a program, while its PLC runs.
//!
//! Takt answers an order when it has taken it; the kernel carries it out in time that no task needs. So each command
//! waits for what came of its order, and tells that. Takt starts with the images of its partition file, so `commit` and
//! `rollback` also put the image of the version that stays there.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use takt_client::versions::{load, shown};
use takt_plan::Program;
use takt_points::{Connected, Plc};
use takt_protocol::{Answer, Request, VersionStatus};

use super::keep::{keep_running, set_aside};
use super::live::print;
use super::read;
use crate::Failure;
use crate::live::Which;
use crate::status;

/// How long a command waits for the PLC's kernel, or for one more job of a trial.
pub const PATIENCE: Duration = Duration::from_secs(10);

/// Arguments of `versions`.
#[derive(clap::Args)]
pub struct Versions {
    #[command(flatten)]
    which: Which,
    /// One program; without it, all of the partition.
    program: Option<String>,
}

impl Versions {
    pub fn run(self) -> Result<(), Failure> {
        let plc = self.which.load()?;
        if let Some(program) = &self.program {
            find(&plc, program)?;
        }
        let mut connected = plc.reach()?;
        for version in versions(&mut connected)? {
            if self.program.as_ref().is_none_or(|program| *program == version.program) {
                print(shown(&version).trim_end())?;
            }
        }
        Ok(())
    }
}

/// Arguments of `load`.
#[derive(clap::Args)]
pub struct Load {
    #[command(flatten)]
    which: Which,
    /// The program's name in the partition file.
    program: String,
    /// The image of the new version.
    image: PathBuf,
}

impl Load {
    /// Sends the image, and waits until it is mapped.
    pub fn run(self) -> Result<(), Failure> {
        let plc = self.which.load()?;
        let program = find(&plc, &self.program)?;
        let mut connected = plc.reach()?;
        for request in load(&connected.name(), &self.program, &self.image)? {
            let answer = connected.ask(&request)?;
            if let (Request::Load(part), Answer::Done { text }) = (&request, answer)
                && part.part + 1 == part.parts
            {
                print(&takt_client::plain(&text))?;
            }
        }
        follow(&mut connected, &self.program, "preparing", &["prepared"])?;
        set_aside(program, &read(&self.image)?)
    }
}

/// Arguments of `commit` and `rollback`.
#[derive(clap::Args)]
pub struct Order {
    #[command(flatten)]
    which: Which,
    /// The program's name in the partition file.
    program: String,
    /// Leave the image of the partition file as it is: the next start of Takt begins with that.
    #[arg(long)]
    until_restart: bool,
}

impl Order {
    /// Enters the version that was loaded; the next start begins with it if it passes its trial.
    pub fn commit(self) -> Result<(), Failure> {
        let good = if self.until_restart { &["trial", "held"][..] } else { &["held"] };
        self.run(Request::Commit, "committing", good)
    }

    /// Goes back; the next start begins with the version that runs again.
    pub fn roll_back(self) -> Result<(), Failure> {
        self.run(Request::RollBack, "rolling-back", &["rolled-back", "none"])
    }

    fn run(
        self,
        request: fn(String, String) -> Request,
        during: &str,
        good: &[&str],
    ) -> Result<(), Failure> {
        let plc = self.which.load()?;
        let program = find(&plc, &self.program)?;
        let mut connected = plc.reach()?;
        let order = request(connected.name(), self.program.clone());
        if let Answer::Done { text } = connected.ask(&order)? {
            print(&takt_client::plain(&text))?;
        }
        let mut stands =
            follow(&mut connected, &self.program, during, &[good, &["trial"]].concat())?;
        if !good.contains(&stands.phase.as_str()) {
            stands = follow(&mut connected, &self.program, "trial", good)?;
        }
        // What was only prepared has changed nothing.
        if self.until_restart || stands.phase == "none" {
            return Ok(());
        }
        keep_running(program, &stands.running)
    }
}

/// That the partition has this program is known before anything is asked.
pub fn find<'a>(plc: &'a Plc, program: &str) -> Result<&'a Program, Failure> {
    let programs = plc.partition().programs();
    if let Some(found) = programs.iter().find(|known| known.name == program) {
        return Ok(found);
    }
    let names: Vec<&str> = programs.iter().map(|program| program.name.as_str()).collect();
    Err(Failure::input(format!("no program is named `{program}`; there are {}", names.join(", "))))
}

/// The versions of all programs of the partition.
pub fn versions(connected: &mut Connected<'_>) -> Result<Vec<VersionStatus>, Failure> {
    match connected.ask(&Request::Versions(connected.name()))? {
        Answer::Versions { versions } => Ok(versions),
        _ => Ok(Vec::new()),
    }
}

/// Waits until a program's change is in another phase than `during`, and tells how it stands then.
fn follow(
    connected: &mut Connected<'_>,
    program: &str,
    during: &str,
    good: &[&str],
) -> Result<VersionStatus, Failure> {
    let version = outlast(connected, program, &[during])?;
    print(shown(&version).trim_end())?;
    if good.contains(&version.phase.as_str()) {
        return Ok(version);
    }
    let waited = PATIENCE.as_secs();
    let message = match during {
        _ if version.phase != during => format!("{program} is now {}", version.phase),
        "trial" => format!(
            "{program} is still on trial, and has had no job for {waited} s: the next start begins with the version before. \
             `takt plc keep` changes that when `takt plc versions` shows it held"
        ),
        _ => format!(
            "{program} is still {during} after {waited} s: the PLC's kernel has no time between two jobs for it. `takt plc \
             versions` tells how it stands, `takt plc rollback` takes the order back"
        ),
    };
    Err(Failure { status: status::REFUSED, message })
}

/// How a program's change stands when it is in none of these phases any more, or has had no job for [`PATIENCE`] in one:
/// a trial may take as long as it likes, if it goes on.
pub fn outlast(
    connected: &mut Connected<'_>,
    program: &str,
    phases: &[&str],
) -> Result<VersionStatus, Failure> {
    let (mut end, mut jobs) = (Instant::now() + PATIENCE, None);
    loop {
        let all = versions(connected)?;
        let Some(version) = all.into_iter().find(|version| version.program == program) else {
            return Err(Failure::input(format!("the Takt that answers runs no program {program}")));
        };
        if jobs.replace(version.jobs) != Some(version.jobs) {
            end = Instant::now() + PATIENCE;
        }
        if !phases.contains(&version.phase.as_str()) || Instant::now() >= end {
            return Ok(version);
        }
    }
}
