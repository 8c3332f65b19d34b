//! What Takt itself takes: memory and time to start.

use std::fs;

use crate::{Measured, partition};

/// Memory and start.
pub fn table(measured: &Measured) -> Option<String> {
    let mut text = "| | a PLC alone | beside a Linux of 128 MiB | of 384 MiB |\n\
                    | --- | --- | --- | --- |\n"
        .to_owned();
    let runs = ["start-alone", "start-128", "start-384"];
    let mut row = |label: &str, of: &dyn Fn(&str) -> Option<String>| {
        let cells: Option<Vec<String>> = runs.iter().map(|run| of(run)).collect();
        text += &format!("| {label} | {} |\n", cells?.join(" | "));
        Some(())
    };
    let kib = |run: &str, key: &str| status(&measured.text(&format!("{run}.status"))?, key);
    // All of it is locked. In the lab the program's file lies in memory like the guests', and the
    // kernel counts both alike.
    row("data of its own", &|run| Some(format!("{} KiB", kib(run, "RssAnon")?)))?;
    row("code and constants of its own", &|run| Some(format!("{} KiB", kib(run, "VmExe")?)))?;
    row("all that is resident, guests included", &|run| {
        Some(format!("{} KiB", kib(run, "VmRSS")?))
    })?;
    row("from exec to the first release", &|run| Some(ms(start_ns(measured, run)?)))?;
    row("of that, to clear the guests' memory", &|run| Some(ms(clearing_ns(measured, run)?)))?;
    row("besides", &|run| {
        Some(ms(start_ns(measured, run)?.saturating_sub(clearing_ns(measured, run)?)))
    })?;
    let more = clearing_ns(measured, runs[2])?.saturating_sub(clearing_ns(measured, runs[1])?);
    let per_mebibyte = more / 256;
    let report = measured.json("start-128.json")?;
    let boot = partition(&report, "linux")?["boot_to_init_ns"].as_u64()?;
    let takt = std::env::current_exe().ok()?.with_file_name("takt");
    Some(format!(
        "{text}\n\
         Each MiB of guest memory takes {:.2} ms to be cleared. A Linux with an initrd of {} MiB reaches its first process {:.3} s after the first release. The program, statically \
         linked, has {:.2} MiB.\n",
        per_mebibyte as f64 / 1e6,
        fs::metadata(measured.folder.join("../guest/initrd.img")).ok()?.len() >> 20,
        boot as f64 / 1e9,
        fs::metadata(takt).ok()?.len() as f64 / f64::from(1 << 20),
    ))
}

/// A value of `/proc/PID/status` in KiB.
fn status(text: &str, key: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(':'))?;
    line.trim().strip_suffix(" kB")?.parse().ok()
}

fn ms(ns: u64) -> String {
    format!("{:.1} ms", ns as f64 / 1e6)
}

/// Of the start: what it took to clear the guests' memory.
fn clearing_ns(measured: &Measured, run: &str) -> Option<u64> {
    measured.json(&format!("{run}.json"))?["process"]["starting"]["clearing_ns"].as_u64()
}

/// From the exec of takt to the epoch, which is the first release.
fn start_ns(measured: &Measured, run: &str) -> Option<u64> {
    let report = measured.json(&format!("{run}.json"))?;
    let ticks = report["epoch_tsc"].as_u64()? - measured.paid(&format!("{run}.log"), "become")?;
    Some(ticks * 1_000_000 / report["host"]["tsc_khz"].as_u64()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_status_is_read_by_its_whole_key() {
        let text = "RssAnonX:\t  9 kB\nRssAnon:\t     132 kB\nRssFile:\t1 MB\n";
        assert_eq!(status(text, "RssAnon"), Some(132));
        assert_eq!(status(text, "RssFile"), None);
        assert_eq!(status(text, "Rss"), None);
    }
}
