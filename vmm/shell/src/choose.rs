//! Which guest is meant.

use takt_plan::{Cid, Partition, PartitionFile};

use crate::ShellError;
use crate::ssh::Guest;

/// A partition that can be reached: its name and number.
pub type Reachable<'a> = (&'a str, Cid);

/// The partitions that can be reached, in the order of the file.
pub fn reachable(file: &PartitionFile) -> Vec<Reachable<'_>> {
    let of = |partition| Some((Partition::name(partition), partition.vsock()?));
    file.partitions().iter().filter_map(of).collect()
}

/// The one of this name, or the only one.
///
/// # Errors
/// If there is none, or which one is not said.
pub fn guest(file: &PartitionFile, name: Option<&str>) -> Result<Guest, ShellError> {
    let (partition, cid) = choose(&reachable(file), name)?;
    Ok(Guest { partition: partition.to_owned(), system: file.name().to_owned(), cid })
}

/// One of them.
pub fn choose<'a>(all: &[Reachable<'a>], name: Option<&str>) -> Result<Reachable<'a>, ShellError> {
    let those = || all.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ");
    match (name, all) {
        (_, []) => Err(ShellError::NoneHas),
        (None, [only]) => Ok(*only),
        (None, _) => Err(ShellError::Several(those())),
        (Some(name), _) => {
            let named = all.iter().find(|(other, _)| *other == name).copied();
            named.ok_or_else(|| ShellError::NotThis { name: name.to_owned(), those: those() })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HMI: Reachable<'_> = ("hmi", Cid(3));
    const DATA: Reachable<'_> = ("data", Cid(4));

    #[test]
    fn a_name_is_needed_if_there_are_several() {
        assert_eq!(choose(&[HMI], None).unwrap(), HMI);
        assert_eq!(choose(&[HMI, DATA], Some("data")).unwrap(), DATA);
        let error = choose(&[HMI, DATA], None).unwrap_err();
        assert!(error.to_string().ends_with(": hmi, data"), "{error}");
        assert_eq!(error.status(), 2);
    }

    #[test]
    fn a_name_that_is_not_reachable_is_refused_even_if_there_is_one_only() {
        let error = choose(&[HMI], Some("plc")).unwrap_err();
        assert!(matches!(&error, ShellError::NotThis { name, .. } if name == "plc"), "{error}");
        assert!(matches!(choose(&[], None), Err(ShellError::NoneHas)));
        assert!(matches!(choose(&[], Some("hmi")), Err(ShellError::NoneHas)));
    }
}
