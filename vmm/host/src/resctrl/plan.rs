//! Who gets what: from what partitions ask for to the lines that are written.
//!
//! A partition with `cache` has its ways for itself: the default group, in which all other threads are, gets
//! what is left, and so does a group that is made for bandwidth only. The ways of all partitions lie
//! in a row at one end of the mask, so that the rest is in a row too, which the processor demands. That
//! end is the one where no device shares them.

use takt_scheduler::table::Cpu;

use super::{CacheInfo, Info, PREFIX, ResctrlError, Resource, Schemata};

/// What one partition asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Asked {
    /// Its name.
    pub partition: String,
    /// The CPU that it runs on.
    pub cpu: Cpu,
    /// The L3 cache of that CPU; `None` if the kernel does not tell.
    pub domain: Option<u32>,
    /// Ways of the L3 cache.
    pub ways: Option<u32>,
    /// Per cent of the memory bandwidth.
    pub percent: Option<u32>,
}

/// A group that is to be made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// The partition whose threads belong into it.
    pub partition: String,
    /// Its folder.
    pub folder: String,
    /// What is written to its schemata.
    pub lines: Vec<String>,
}

/// What is to be written.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Plan {
    /// One for each partition that asks for something, in their order.
    pub groups: Vec<Group>,
    /// To the schemata of the default group, once the others are made.
    pub taken: Vec<String>,
    /// To the same, at the end.
    pub given_back: Vec<String>,
}

/// Finds out who gets what. `default` is what the default group has, and `others` are the groups that are
/// not Takt's, by their names.
///
/// # Errors
/// What cannot be had, see [`ResctrlError`].
pub fn plan(
    asked: &[Asked],
    info: Info,
    default: &Schemata,
    others: &[(String, Schemata)],
) -> Result<Plan, ResctrlError> {
    let mut plan = Plan::default();
    let mut groups = Vec::new();
    for one in asked {
        groups.push((one, domain(one)?, bandwidth(one, info)?));
    }
    enough_groups(asked.len(), others.len(), info)?;
    let mut caches: Vec<(u32, Division)> = Vec::new();
    for (one, domain, _) in &groups {
        let Some(ways) = one.ways else { continue };
        let partition = || one.partition.clone();
        let cache = info.cache.ok_or_else(|| ResctrlError::NoCache { partition: partition() })?;
        if ways < cache.least {
            let (partition, least) = (partition(), cache.least);
            return Err(ResctrlError::TooFewWays { partition, ways, least });
        }
        if caches.iter().all(|(of, _)| of != domain) {
            let wanted = groups.iter().filter(|(_, of, _)| of == domain);
            let wanted = wanted.filter_map(|(one, ..)| one.ways).fold(0, u32::saturating_add);
            let division = divide(*domain, wanted, cache, default, others)?;
            plan.taken.push(Resource::Cache.line(*domain, division.rest));
            plan.given_back.push(Resource::Cache.line(*domain, cache.all));
            caches.push((*domain, division));
        }
    }
    for (one, domain, percent) in groups {
        let mut lines = Vec::new();
        // A new group begins with all ways that may be shared, and a Linux may have processors beside several caches.
        for (of, division) in &mut caches {
            let own = one.ways.filter(|_| *of == domain);
            let ways = own.map_or(division.rest, |ways| division.next(ways));
            lines.push(Resource::Cache.line(*of, ways));
        }
        lines.extend(percent.map(|percent| Resource::Bandwidth.line(domain, percent)));
        let folder = format!("{PREFIX}{}", one.partition);
        plan.groups.push(Group { partition: one.partition.clone(), folder, lines });
    }
    Ok(plan)
}

fn domain(asked: &Asked) -> Result<u32, ResctrlError> {
    asked.domain.ok_or_else(|| ResctrlError::NoDomain {
        partition: asked.partition.clone(),
        cpu: asked.cpu,
    })
}

fn bandwidth(asked: &Asked, info: Info) -> Result<Option<u32>, ResctrlError> {
    let Some(percent) = asked.percent else { return Ok(None) };
    let partition = asked.partition.clone();
    if info.absolute {
        return Err(ResctrlError::Absolute { partition });
    }
    let Some(bandwidth) = info.bandwidth else {
        return Err(ResctrlError::NoBandwidth { partition });
    };
    let (step, least) = (bandwidth.step, bandwidth.least);
    // The kernel would round it up and keep quiet of it.
    if percent < least || percent % step != 0 {
        return Err(ResctrlError::Percentage { partition, percent, step, least });
    }
    Ok(Some(percent))
}

/// The processor has so many for all that it divides (`closid_init` in the kernel's
/// `arch/x86/kernel/cpu/resctrl/rdtgroup.c`).
fn enough_groups(wanted: usize, others: usize, info: Info) -> Result<(), ResctrlError> {
    let cache = info.cache.map(|cache| cache.groups);
    let all = cache.into_iter().chain(info.bandwidth.map(|bandwidth| bandwidth.groups)).min();
    let (all, there, wanted) = (all.unwrap_or(0), others + 1, wanted);
    if wanted > 0 && there + wanted > all as usize {
        let (there, wanted) = (there as u32, wanted as u32);
        return Err(ResctrlError::TooManyGroups { all, there, wanted });
    }
    Ok(())
}

/// One cache, divided.
struct Division {
    /// The lowest way that no partition has yet.
    next: u32,
    /// The ways that no partition has for itself.
    rest: u32,
}

impl Division {
    /// The ways of the next partition.
    fn next(&mut self, ways: u32) -> u32 {
        let mask = in_a_row(self.next, ways);
        self.next += ways;
        mask
    }
}

fn divide(
    domain: u32,
    wanted: u32,
    cache: CacheInfo,
    default: &Schemata,
    others: &[(String, Schemata)],
) -> Result<Division, ResctrlError> {
    let CacheInfo { all: mask, least, shared, .. } = cache;
    let all = mask.count_ones();
    // The kernel has the lowest way at bit 0, always.
    if wanted.saturating_add(least) > all {
        return Err(ResctrlError::TooManyWays { domain, all, wanted, least });
    }
    let has = default.ways(domain).unwrap_or(0);
    if has != mask {
        return Err(ResctrlError::Divided { domain, has, all: mask });
    }
    let ends = [0, all - wanted].map(|first| (first, in_a_row(first, wanted)));
    let Some((first, own)) = ends.into_iter().find(|(_, own)| own & shared == 0) else {
        return Err(ResctrlError::Shared { domain, wanted, shared, all: mask });
    };
    let taken = others
        .iter()
        .find(|(_, schemata)| schemata.ways(domain).is_some_and(|ways| ways & own != 0));
    if let Some((group, _)) = taken {
        return Err(ResctrlError::Taken { group: group.clone(), domain });
    }
    Ok(Division { next: first, rest: mask & !own })
}

/// So many bits from `first` on.
fn in_a_row(first: u32, count: u32) -> u32 {
    let row = 1u64.checked_shl(count).map_or(u64::MAX, |above| above - 1);
    (row << first.min(63)) as u32
}

#[cfg(test)]
#[path = "plan_tests.rs"]
mod tests;
