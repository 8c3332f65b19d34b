//! PCI functions that are given to a partition, in a sysfs of files.

use super::*;

const NAME: &str = "0000:00:04.0";

/// What sysfs would show of a function, in a folder of the test's own.
struct Sysfs(PathBuf);

impl Sysfs {
    fn new(command: u16) -> Sysfs {
        let name = format!("takt-pci-{}-{:?}", std::process::id(), std::thread::current().id());
        let root = std::env::temp_dir().join(name);
        let _ = fs::remove_dir_all(&root);
        let this = Sysfs(root);
        let function = this.function();
        fs::create_dir_all(&function).unwrap();
        let mut config = [0; 64];
        config[4..6].copy_from_slice(&command.to_le_bytes());
        fs::write(function.join("config"), config).unwrap();
        fs::write(function.join("enable"), "").unwrap();
        fs::write(function.join("driver_override"), "(null)\n").unwrap();
        fs::write(
            function.join("resource"),
            "0x00000000fea00000 0x00000000feafffff 0x0000000000040200\n\
             0x000000000000c080 0x000000000000c0ff 0x0000000000040101\n\
             0x0000000000000000 0x0000000000000000 0x0000000000000000\n",
        )
        .unwrap();
        this
    }

    fn function(&self) -> PathBuf {
        self.0.join("devices").join(NAME)
    }

    fn bind(&self) {
        self.bind_to("some");
    }

    fn bind_to(&self, driver: &str) {
        let driver = self.0.join("drivers").join(driver);
        fs::create_dir_all(&driver).unwrap();
        std::os::unix::fs::symlink(&driver, self.function().join("driver")).unwrap();
    }

    fn vfio(&self) {
        fs::create_dir_all(self.0.join("drivers/vfio-pci")).unwrap();
    }

    /// The driver for interrupts, and the device that it makes.
    fn uio(&self) {
        fs::create_dir_all(self.0.join("drivers/uio_pci_generic")).unwrap();
        fs::create_dir_all(self.function().join("uio/uio7")).unwrap();
        fs::write(self.0.join("uio7"), "").unwrap();
    }

    fn take(&self, terms: Terms) -> Result<Function, DeviceError> {
        Function::take(&self.0.join("devices"), NAME, terms)
    }

    fn command(&self) -> u16 {
        let config = fs::read(self.function().join("config")).unwrap();
        u16::from_le_bytes([config[4], config[5]])
    }

    fn text(&self, path: &str) -> String {
        fs::read_to_string(self.0.join(path)).unwrap_or_default()
    }
}

impl Drop for Sysfs {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn bus_mastering_is_off_while_a_guest_has_the_function() {
    let sysfs = Sysfs::new(0x404);
    let function = sysfs.take(Terms::default()).unwrap();
    assert_eq!(sysfs.command(), 0x403);
    assert_eq!(fs::read_to_string(sysfs.function().join("enable")).unwrap(), "1");
    drop(function);
    assert_eq!(sysfs.command(), 0x400, "what the guest has left in the device must not start");
    assert_eq!(fs::read_to_string(sysfs.function().join("enable")).unwrap(), "0");
}

#[test]
fn a_trusted_function_may_master_the_bus() {
    for (found, taken) in [(0, 0x407), (0x104, 0x507)] {
        let sysfs = Sysfs::new(found);
        let terms = Terms { trusted_dma: true, ..Terms::default() };
        let function = sysfs.take(terms).unwrap();
        assert_eq!(sysfs.command(), taken);
        drop(function);
        assert_eq!(sysfs.command(), found);
    }
}

#[test]
fn a_function_is_reset_before_the_hosts_driver_has_it_again() {
    let reset = format!("devices/{NAME}/reset");
    let terms = Terms { unbind: true, ..Terms::default() };
    let sysfs = Sysfs::new(7);
    sysfs.bind();
    fs::write(sysfs.0.join(&reset), "").unwrap();
    drop(sysfs.take(terms).unwrap());
    assert_eq!(
        (sysfs.text(&reset).as_str(), sysfs.text("drivers/some/bind").as_str()),
        ("1", NAME)
    );

    // A reset that fails leaves it without a driver, which would let it master the bus.
    fs::remove_file(sysfs.0.join(&reset)).unwrap();
    fs::create_dir(sysfs.0.join(&reset)).unwrap();
    fs::write(sysfs.0.join("drivers/some/bind"), "").unwrap();
    drop(sysfs.take(terms).unwrap());
    assert_eq!(sysfs.text("drivers/some/bind"), "");
}

#[test]
fn a_function_without_a_driver_of_the_hosts_keeps_its_outputs() {
    let sysfs = Sysfs::new(7);
    let reset = format!("devices/{NAME}/reset");
    fs::write(sysfs.0.join(&reset), "").unwrap();
    drop(sysfs.take(Terms::default()).unwrap());
    assert_eq!(sysfs.text(&reset), "");
}

#[test]
fn the_hosts_driver_is_asked_before_it_is_taken_away() {
    let sysfs = Sysfs::new(7);
    sysfs.bind();
    let error = sysfs.take(Terms::default()).unwrap_err().to_string();
    assert!(error.starts_with("0000:00:04.0 is in use by the host's driver some: "), "{error}");
    assert!(error.contains("echo 0000:00:04.0 > /sys/bus/pci/drivers/some/unbind"), "{error}");
    assert_eq!((sysfs.command(), sysfs.text("drivers/some/unbind")), (7, String::new()));

    let function = sysfs.take(Terms { unbind: true, ..Terms::default() }).unwrap();
    assert_eq!(function.driver().as_deref(), Some("some"));
    assert_eq!(sysfs.text("drivers/some/unbind"), NAME);
    assert_eq!(sysfs.text("drivers/some/bind"), "");
    drop(function);
    assert_eq!(sysfs.text("drivers/some/bind"), NAME);
    assert_eq!(sysfs.command(), 3);
}

#[test]
fn registers_are_told_with_their_kind() {
    let sysfs = Sysfs::new(0);
    let function = sysfs.take(Terms::default()).unwrap();
    let memory = function.resource(0).unwrap().unwrap();
    assert_eq!((memory.start, memory.length), (0xfea0_0000, 0x10_0000));
    assert!(memory.is_memory() && !memory.is_ports());
    let ports = function.resource(1).unwrap().unwrap();
    assert_eq!((ports.start, ports.length), (0xc080, 0x80));
    assert!(ports.is_ports() && !ports.is_memory());
    assert_eq!(function.resource(2).unwrap(), None);
    assert!(matches!(function.resource(3), Err(DeviceError::Unexpected(_))));
}

#[test]
fn what_sysfs_should_not_say_is_an_error() {
    let sysfs = Sysfs::new(0);
    let function = sysfs.take(Terms::default()).unwrap();
    for line in ["", "0x1 0x2", "1 2 3", "0x2 0x1 0x200", "0x0 0xffffffffffffffff 0x200", "x y z"] {
        fs::write(sysfs.function().join("resource"), format!("{line}\n")).unwrap();
        assert!(matches!(function.resource(0), Err(DeviceError::Unexpected(_))), "{line}");
    }
}

#[test]
fn a_function_that_is_not_there_is_named() {
    let sysfs = Sysfs::new(0);
    let error = Function::take(&sysfs.0.join("devices"), "0000:00:05.0", Terms::default());
    let error = error.unwrap_err().to_string();
    assert!(error.starts_with("there is no device 0000:00:05.0: "), "{error}");
}

#[test]
fn the_interrupt_of_a_function_is_off_until_it_is_asked_for() {
    let sysfs = Sysfs::new(7);
    let function = sysfs.take(Terms::default()).unwrap();
    assert_eq!(sysfs.command(), 0x403);
    drop(function);
    assert_eq!(sysfs.command(), 3);

    sysfs.bind();
    sysfs.uio();
    let terms = Terms { unbind: true, interrupt: true, ..Terms::default() };
    let function = sysfs.take(terms).unwrap();
    let line = function.line(&sysfs.0).unwrap();
    let overridden = || sysfs.text(&format!("devices/{NAME}/driver_override"));
    assert_eq!(overridden(), "uio_pci_generic");
    assert_eq!(sysfs.text("drivers/uio_pci_generic/bind"), NAME);
    assert_eq!(sysfs.command(), 0x403);
    line.arm().unwrap();
    assert_eq!(sysfs.command(), 3);

    // No driver on the host would end an interrupt that the guest has left behind.
    drop((line, function));
    assert_eq!(sysfs.command(), 0x403);
    assert_eq!(
        (overridden().as_str(), sysfs.text("drivers/uio_pci_generic/unbind").as_str()),
        ("\n", NAME)
    );
    assert_eq!(sysfs.text("drivers/some/bind"), NAME);
}

#[test]
fn a_host_without_the_driver_for_interrupts_is_told_which() {
    let sysfs = Sysfs::new(7);
    let terms = Terms { interrupt: true, ..Terms::default() };
    let error = sysfs.take(terms).unwrap_err().to_string();
    assert!(error.contains("`modprobe uio_pci_generic`"), "{error}");
    assert_eq!(fs::read_to_string(sysfs.function().join("enable")).unwrap(), "0");
    assert_eq!(sysfs.command(), 7);

    // A function without an interrupt has no line.
    let function = sysfs.take(Terms::default()).unwrap();
    assert!(matches!(function.line(&sysfs.0), Err(DeviceError::NoUio(_))));
}

#[test]
fn a_function_for_vfio_has_its_driver_and_is_otherwise_left_to_it() {
    let sysfs = Sysfs::new(0x407);
    let terms = Terms { unbind: true, vfio: true, interrupt: true, ..Terms::default() };
    let error = sysfs.take(terms).unwrap_err().to_string();
    assert!(error.contains("`modprobe vfio-pci`"), "{error}");

    sysfs.bind();
    sysfs.vfio();
    let function = sysfs.take(terms).unwrap();
    let overridden = || sysfs.text(&format!("devices/{NAME}/driver_override"));
    assert_eq!(
        (overridden().as_str(), sysfs.text("drivers/vfio-pci/bind").as_str()),
        ("vfio-pci", NAME)
    );
    assert_eq!(
        (sysfs.command(), fs::read(sysfs.function().join("enable")).unwrap().len()),
        (0x407, 0)
    );
    assert!(function.confined().is_none());

    drop(function);
    assert_eq!(
        (overridden().as_str(), sysfs.text("drivers/vfio-pci/unbind").as_str()),
        ("\n", NAME)
    );
    assert_eq!(sysfs.text("drivers/some/bind"), NAME);
    assert_eq!(sysfs.command(), 0x407);
}

#[test]
fn a_driver_that_a_cut_off_run_has_left_over_is_taken_away_for_good() {
    let interrupt = Terms { interrupt: true, ..Terms::default() };
    let vfio = Terms { vfio: true, ..Terms::default() };
    for (terms, driver) in [(interrupt, "uio_pci_generic"), (vfio, "vfio-pci")] {
        for unbind in [false, true] {
            let terms = Terms { unbind, ..terms };
            let sysfs = Sysfs::new(0);
            sysfs.bind_to(driver);
            let chosen = format!("devices/{NAME}/driver_override");
            fs::write(sysfs.0.join(&chosen), format!("{driver}\n")).unwrap();
            let function = sysfs.take(terms).unwrap();
            assert_eq!(sysfs.text(&format!("drivers/{driver}/unbind")), NAME);
            assert_eq!((function.driver(), sysfs.text(&chosen).as_str()), (None, driver));
            // The driver of the host's is not that one.
            fs::write(sysfs.0.join(format!("drivers/{driver}/bind")), "").unwrap();
            drop(function);
            assert_eq!(sysfs.text(&format!("drivers/{driver}/bind")), "");
            assert_eq!(sysfs.text(&chosen), "\n");
        }
    }
}

#[test]
fn a_choice_of_the_driver_that_was_made_before_is_put_back() {
    let sysfs = Sysfs::new(0);
    let chosen = format!("devices/{NAME}/driver_override");
    fs::write(sysfs.0.join(&chosen), "some\n").unwrap();
    sysfs.bind();
    sysfs.vfio();
    let function = sysfs.take(Terms { unbind: true, vfio: true, ..Terms::default() }).unwrap();
    assert_eq!(sysfs.text(&chosen), "vfio-pci");
    drop(function);
    assert_eq!(
        (sysfs.text(&chosen).as_str(), sysfs.text("drivers/some/bind").as_str()),
        ("some\n", NAME)
    );
}

#[test]
fn a_driver_that_takt_did_not_choose_is_the_hosts() {
    let sysfs = Sysfs::new(0);
    sysfs.bind_to("vfio-pci");
    let vfio = Terms { vfio: true, ..Terms::default() };
    let in_use = |terms| matches!(sysfs.take(terms), Err(DeviceError::InUse { .. }));
    assert!(in_use(vfio), "no run of takt's has chosen it");
    let chosen = sysfs.function().join("driver_override");
    fs::write(&chosen, "vfio-pci\n").unwrap();
    assert!(in_use(Terms { interrupt: true, ..Terms::default() }), "takt would bind another");
    assert!(in_use(Terms::default()), "takt would bind none");
    assert_eq!(fs::read_to_string(chosen).unwrap(), "vfio-pci\n");
}
