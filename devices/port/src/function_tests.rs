//! A folder stands for the bus.

use super::*;

fn device(bus: &Path, name: &str, vendor: &str, device: &str) {
    let folder = bus.join(name);
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("vendor"), vendor).unwrap();
    fs::write(folder.join("device"), device).unwrap();
}

#[test]
fn the_first_function_with_both_numbers_is_found_among_others() {
    let bus = std::env::temp_dir().join(format!("takt-port-bus-{}", std::process::id()));
    device(&bus, "0000:00:00.0", "0x8086\n", "0x1237\n");
    device(&bus, "0000:00:01.0", "0x1af4\n", "0x1000\n");
    device(&bus, "0000:00:02.0", "nonsense", "");
    fs::create_dir_all(bus.join("0000:00:03.0")).unwrap();
    assert!(matches!(find(&bus), Err(PortsError::NotFound(at)) if at == bus));
    device(&bus, "0000:00:05.0", "0x1af4\n", "0x10f0\n");
    device(&bus, "0000:00:04.0", "0x1af4\n", "0x10f0\n");
    let found = find(&bus).unwrap();
    assert_eq!(found, bus.join("0000:00:04.0"));
    assert_eq!(uio(&found), None);
    fs::create_dir_all(found.join("uio/uio7")).unwrap();
    assert_eq!(uio(&found), Some(PathBuf::from("/dev/uio7")));
    fs::remove_dir_all(&bus).unwrap();
    assert!(find(&bus).is_err());
}

#[test]
fn a_region_is_where_its_line_says() {
    let line = |first: u64, last: u64| format!("0x{first:016x} 0x{last:016x} 0x0000000000040200\n");
    let resource = line(0, 0) + &line(0xc000_0000, 0xc000_ffff) + &line(0xc001_0000, 0xc001_0fff);
    let region = |offset, bytes| Some(Region { offset, bytes });
    assert_eq!(region_of(&resource, 0), None);
    assert_eq!(region_of(&resource, 1), region(0xc000_0000, 0x1_0000));
    assert_eq!(region_of(&resource, 2), region(0xc001_0000, 0x1000));
    assert_eq!(region_of(&resource, 3), None);
    for bad in ["", "0x1000", "0x1000 fff", "0x2000 0x1000 0x0", "0x1 0xffffffffffffffffff 0x0"] {
        assert_eq!(region_of(bad, 0), None, "{bad:?}");
    }
    assert_eq!(region_of(&line(1, u64::MAX), 0), region(1, u64::MAX));
}

#[test]
fn only_functions_of_the_kernels_are_looked_for_in_physical_memory() {
    let folder = std::env::temp_dir().join(format!("takt-port-region-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("resource"), "0x1000 0x1fff 0x0\n").unwrap();
    assert_eq!(region(&folder, 0), None);
    fs::remove_dir_all(&folder).unwrap();
}
