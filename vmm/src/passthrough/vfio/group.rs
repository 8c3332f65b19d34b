//! Which functions an I/O memory management unit cannot tell apart.
//!
//! Where a bridge does not say which function behind it a transfer is from, or functions can reach
//! each other before they reach the unit, the kernel puts them into one group, and a group has one
//! address space (`Documentation/driver-api/vfio.rst`). So a partition that gets one function
//! of a group gets all, or none.

use std::fs;
use std::path::Path;

use super::super::error::DeviceError;

/// Class codes of bridges between buses begin with this (PCI Code and ID Assignment, "Base Class
/// 06h"). VFIO allows one in a group with its driver: only the kernel programs it.
const BRIDGE: &str = "0x0604";

/// The number of the group of the function `name`, whose folder is in `devices`, if all others of its
/// group are among `own`.
///
/// # Errors
/// If it has no group, that is, if no unit is in front of it, or shares it.
pub fn of(devices: &Path, name: &str, own: &[&str]) -> Result<u32, DeviceError> {
    let link = devices.join(name).join("iommu_group");
    let Ok(folder) = link.canonicalize() else {
        return Err(DeviceError::NoIommu(name.to_owned()));
    };
    let unexpected = || DeviceError::Unexpected(link.clone());
    let number = folder.file_name().and_then(|number| number.to_str()?.parse().ok());
    let number: u32 = number.ok_or_else(unexpected)?;
    for entry in fs::read_dir(folder.join("devices")).map_err(|_| unexpected())? {
        let fellow = entry.map_err(|_| unexpected())?.file_name();
        let fellow = fellow.to_str().ok_or_else(unexpected)?;
        let class = fs::read_to_string(devices.join(fellow).join("class")).unwrap_or_default();
        if fellow != name && !own.contains(&fellow) && !class.starts_with(BRIDGE) {
            return Err(DeviceError::SharedGroup {
                function: name.to_owned(),
                group: number,
                fellow: fellow.to_owned(),
            });
        }
    }
    Ok(number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;
    use std::path::PathBuf;

    const NAME: &str = "0000:01:00.0";

    /// Functions with their classes, all of group 7.
    fn group(test: &str, functions: &[(&str, &str)]) -> PathBuf {
        let root = std::env::temp_dir().join(format!("takt-{test}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&root);
        let group = root.join("groups/7");
        for (name, class) in functions {
            let folder = root.join("devices").join(name);
            fs::create_dir_all(&folder).unwrap();
            fs::create_dir_all(group.join("devices").join(name)).unwrap();
            fs::write(folder.join("class"), format!("{class}\n")).unwrap();
            symlink(&group, folder.join("iommu_group")).unwrap();
        }
        root
    }

    #[test]
    fn a_function_comes_with_all_of_its_group_but_bridges() {
        let all = [(NAME, "0x020000"), ("0000:01:00.1", "0x020000"), ("0000:00:1c.0", "0x060400")];
        let root = group("group-shared", &all);
        let devices = root.join("devices");
        let error = of(&devices, NAME, &[NAME]).unwrap_err().to_string();
        assert!(error.contains("group 7 with 0000:01:00.1"), "{error}");
        assert_eq!(of(&devices, NAME, &[NAME, "0000:01:00.1"]).unwrap(), 7);
        fs::remove_dir_all(root).unwrap();
    }

    #[test]
    fn a_function_without_a_group_has_no_unit_in_front_of_it() {
        let root = group("group-none", &[(NAME, "0x00ff00")]);
        let devices = root.join("devices");
        assert_eq!(of(&devices, NAME, &[]).unwrap(), 7);
        fs::remove_file(devices.join(NAME).join("iommu_group")).unwrap();
        let error = of(&devices, NAME, &[]).unwrap_err();
        assert!(matches!(error, DeviceError::NoIommu(name) if name == NAME));
        fs::remove_dir_all(root).unwrap();
    }

    #[test]
    fn a_group_that_is_no_number_is_not_understood() {
        let root = group("group-odd", &[(NAME, "0x00ff00")]);
        fs::rename(root.join("groups/7"), root.join("groups/x")).unwrap();
        let link = root.join("devices").join(NAME).join("iommu_group");
        fs::remove_file(&link).unwrap();
        symlink(root.join("groups/x"), &link).unwrap();
        let error = of(&root.join("devices"), NAME, &[]).unwrap_err();
        assert!(matches!(error, DeviceError::Unexpected(_)));
        fs::remove_dir_all(root).unwrap();
    }
}
