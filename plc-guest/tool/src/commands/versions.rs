//! `takt plc load`, `versions`, `commit`, `rollback`: another version of a program, while its PLC runs.
//!
//! Takt answers an order when it has taken it; the kernel carries it out in time that no task needs. So each command
//! waits for what came of its order, and tells that. Takt starts with the images of its partition file, so `commit` and
//! `rollback` also put the image of the version that stays there.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use takt_client::versions::{load, read, shown};
use takt_plan::Program;
use takt_points::{Connected, Plc};
use takt_protocol::{Answer, ImageVersion, Request, VersionStatus};

use super::keep::{Found, check_prepared, image_of, keep_running, set_aside};
use super::live::print;
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
        // Once: the next start must not begin with other bytes than were sent.
        let bytes = read(&self.image)?;
        let mut connected = plc.reach()?;
        for request in load(&connected.name(), &self.program, &bytes) {
            let answer = connected.ask(&request)?;
            if let (Request::Load(part), Answer::Done { text }) = (&request, answer)
                && part.part + 1 == part.parts
            {
                print(&takt_client::plain(&text))?;
            }
        }
        follow(&mut connected, &self.program, "preparing", &["prepared"])?;
        set_aside(&plc, program, &bytes)
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
        let plc = self.which.load()?;
        let program = find(&plc, &self.program)?;
        let mut connected = plc.reach()?;
        if !self.until_restart {
            check_prepared(&plc, program, &version(&mut connected, &self.program)?)?;
        }
        order(&mut connected, Request::Commit, &self.program)?;
        let entered = [good, &["trial"]].concat();
        let mut stands = follow(&mut connected, &self.program, "committing", &entered)?;
        if !good.contains(&stands.phase.as_str()) {
            stands = follow(&mut connected, &self.program, "trial", good)?;
        }
        if self.until_restart {
            return Ok(());
        }
        keep_running(&plc, program, &stands.running)
    }

    /// Goes back; the next start begins with the version that runs again.
    pub fn roll_back(self) -> Result<(), Failure> {
        let plc = self.which.load()?;
        let program = find(&plc, &self.program)?;
        let mut connected = plc.reach()?;
        // The phase at the end does not tell which version runs: after a stop of the program it is that of a version
        // that was given up.
        let before = version(&mut connected, &self.program)?;
        // Whether a start could begin with it is asked when it runs again: a way back does not wait for a file.
        order(&mut connected, Request::RollBack, &self.program)?;
        let stands = outlast(&mut connected, &self.program, &GOING_BACK)?;
        print(shown(&stands).trim_end())?;
        let was_entered = matches!(before.phase.as_str(), "trial" | "held");
        let wanted = if was_entered { before.other } else { Some(before.running) };
        let runs = wanted.as_ref().is_some_and(|wanted| wanted.hash == stands.running.hash);
        match stands.phase.as_str() {
            // What was only prepared has changed nothing.
            "none" if runs && !was_entered => Ok(()),
            "none" | "rolled-back" if runs && self.until_restart => Ok(()),
            "none" | "rolled-back" if runs => keep_running(&plc, program, &stands.running),
            "none" | "rolled-back" => Err(not_back(program, &stands.running, wanted)),
            phase if GOING_BACK.contains(&phase) => Err(still(&stands, "")),
            phase => Err(refused(format!("{} is now {}", self.program, takt_client::plain(phase)))),
        }
    }
}

/// The phases in which a roll-back is not carried out yet. Takt leaves a version that was not entered in its phase until
/// the kernel has told that it is given up.
const GOING_BACK: [&str; 4] = ["preparing", "prepared", "committing", "rolling-back"];

/// Gives an order, and tells that Takt has taken it.
fn order(
    connected: &mut Connected<'_>,
    request: fn(String, String) -> Request,
    program: &str,
) -> Result<(), Failure> {
    match connected.ask(&request(connected.name(), program.to_owned()))? {
        Answer::Done { text } => print(&takt_client::plain(&text)),
        _ => Ok(()),
    }
}

/// That another version runs than the one to which a roll-back was to lead, and what leads there now.
fn not_back(program: &Program, running: &ImageVersion, wanted: Option<ImageVersion>) -> Failure {
    let image = wanted.and_then(|wanted| image_of(program, &wanted.hash));
    let (in_place, image) = match image {
        Some(Found { path, is_in_place, .. }) => (is_in_place, path.display().to_string()),
        None => (false, "its image".to_owned()),
    };
    let start = match in_place {
        true => "start Takt anew, which begins with it".to_owned(),
        false => format!("put it in the place of {} and start Takt anew", program.path.display()),
    };
    refused(format!(
        "version {} of {} stays, and the version before did not come back: the kernel had forgotten it, since the program has \
         stopped or was started anew. If the program runs, `takt plc load` and `commit` {image}; else, {start}",
        takt_client::plain(&running.version),
        program.name
    ))
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
    Err(match during {
        _ if version.phase != during => refused(format!("{program} is now {}", version.phase)),
        "trial" => refused(format!(
            "{program} is still on trial, and has had no job for {waited} s: the next start begins with the version before. \
             `takt plc keep` changes that when `takt plc versions` shows it held"
        )),
        _ => still(&version, ", `takt plc rollback` takes the order back"),
    })
}

/// An order was not carried out in time.
fn still(version: &VersionStatus, way_out: &str) -> Failure {
    refused(format!(
        "{} is still {} after {} s: the PLC's kernel has no time between two jobs for it. `takt plc versions` tells how it \
         stands{way_out}",
        takt_client::plain(&version.program),
        takt_client::plain(&version.phase),
        PATIENCE.as_secs()
    ))
}

fn refused(message: String) -> Failure {
    Failure { status: status::REFUSED, message }
}

/// How the versions of a program stand.
fn version(connected: &mut Connected<'_>, program: &str) -> Result<VersionStatus, Failure> {
    let found = versions(connected)?.into_iter().find(|version| version.program == program);
    found.ok_or_else(|| Failure::input(format!("the Takt that answers runs no program {program}")))
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
        let version = version(connected, program)?;
        if jobs.replace(version.jobs) != Some(version.jobs) {
            end = Instant::now() + PATIENCE;
        }
        if !phases.contains(&version.phase.as_str()) || Instant::now() >= end {
            return Ok(version);
        }
    }
}
