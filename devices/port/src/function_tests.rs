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
