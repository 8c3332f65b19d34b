//! Whether the processor can divide its cache and the way to memory as partitions ask for it.

use std::fs;
use std::io;
use std::path::Path;

use takt_host::resctrl::{self, Asked, PREFIX, ResctrlError, Schemata};

use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::Host;

/// Asks for the same plan as `takt run`, and writes nothing. Groups that a killed Takt has left are the next run's
/// to remove, and not in the way.
pub fn shares(host: &Host, demand: &Demand) -> Finding {
    const CHECK: &str = "shares";
    if demand.shares.is_empty() {
        return Finding::good(CHECK, "no partition asks for a share of cache or memory bandwidth");
    }
    match plan(host, demand) {
        Ok(found) => Finding::good(CHECK, found),
        Err(error) => {
            Finding::cannot(CHECK, error.to_string(), "takt run does not start", error.remedy())
        }
    }
}

fn plan(host: &Host, demand: &Demand) -> Result<String, ResctrlError> {
    let top = host.root();
    let root = resctrl::find_below(top)?;
    let failed = |source| ResctrlError::Read { path: root.clone(), source };
    let read = |path: &str| fs::read_to_string(root.join(path));
    let mut others = Vec::new();
    let mut left = false;
    for entry in fs::read_dir(&root).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let name = entry.file_name().into_string().unwrap_or_default();
        if !entry.path().is_dir() || !resctrl::is_group(&name) {
            continue;
        }
        if name.starts_with(PREFIX) {
            left = true;
            continue;
        }
        others.push((name.clone(), schemata(&root.join(&name))?));
    }
    let info = resctrl::info(&resctrl::vendor_below(top), read)?;
    let mut default = schemata(&root)?;
    // What belongs to a group that is left comes back with it.
    if let Some(cache) = info.cache.filter(|_| left) {
        default = default.with_all_ways(cache.all);
    }
    let with_domain =
        |asked: &Asked| Asked { domain: resctrl::domain_below(top, asked.cpu), ..asked.clone() };
    let asked: Vec<Asked> = demand.shares.iter().map(with_domain).collect();
    let plan = resctrl::plan(&asked, info, &default, &others)?;
    let told = |group: &resctrl::Group| format!("{}: {}", group.partition, group.lines.join(", "));
    Ok(plan.groups.iter().map(told).collect::<Vec<_>>().join("; "))
}

fn schemata(folder: &Path) -> Result<Schemata, ResctrlError> {
    let path = folder.join("schemata");
    let text: io::Result<String> = fs::read_to_string(&path);
    text.map(|text| Schemata::new(&text)).map_err(|source| ResctrlError::Read { path, source })
}
