//! Which device of the host's it is that a port range or a piece of memory belongs to.

use std::fmt;

use toml::Spanned;

use super::super::diagnostic::{Diagnostic, Span, quote};
use super::Taken;

/// Base address registers of an ordinary PCI function.
const BARS: i64 = 6;

/// A PCI function, by the name that sysfs has for it: domain, bus, device and function.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PciFunction(String);

impl PciFunction {
    fn parse(text: &str) -> Option<PciFunction> {
        let form = b"xxxx:xx:xx.o";
        let digit = |(found, wanted): (u8, &u8)| match wanted {
            b'x' => matches!(found, b'0'..=b'9' | b'a'..=b'f'),
            b'o' => matches!(found, b'0'..=b'7'),
            other => found == *other,
        };
        let good = text.len() == form.len() && text.bytes().zip(form).all(digit);
        good.then(|| PciFunction(text.to_owned()))
    }

    /// As in sysfs, such as `0000:00:04.0`.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for PciFunction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

/// A base address register of a PCI function, and how that function is taken from the host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bar {
    /// The function.
    pub function: PciFunction,
    /// Which register, 0 to 5.
    pub bar: u8,
    /// Takt may unbind the host's driver.
    pub unbind: bool,
    /// The device may master the bus, and so reach all memory.
    pub trusted_dma: bool,
    /// The device may master the bus, and reaches the partition's memory.
    pub vfio: bool,
}

/// The keys of a table that say which PCI function it is.
pub struct PciKeys<'a> {
    pub pci: &'a Option<Spanned<String>>,
    pub bar: &'a Option<Spanned<i64>>,
    pub unbind: &'a Option<Spanned<bool>>,
    pub trusted_dma: &'a Option<Spanned<bool>>,
    pub vfio: &'a Option<Spanned<bool>>,
    /// The table they stand in.
    pub header: Span,
}

/// A PCI function as a whole.
pub fn check_function(
    pci: &Spanned<String>,
    partition: &str,
    taken: &mut Taken,
) -> Result<PciFunction, Diagnostic> {
    let function = parse_function(pci)?;
    take_function(&function, pci, partition, taken)?;
    Ok(function)
}

fn parse_function(pci: &Spanned<String>) -> Result<PciFunction, Diagnostic> {
    PciFunction::parse(pci.get_ref()).ok_or_else(|| {
        let found = format!("{} is not the address of a PCI function", quote(pci.get_ref()));
        let allowed = "domain, bus, device and function as in /sys/bus/pci/devices, such as \
                       \"0000:00:04.0\"";
        Diagnostic::new(pci.span(), found, allowed)
    })
}

fn take_function(
    function: &PciFunction,
    pci: &Spanned<String>,
    partition: &str,
    taken: &mut Taken,
) -> Result<(), Diagnostic> {
    taken.device(&format!("the PCI function {function}"), partition, pci.span())
}

/// The register of a PCI function, if the table names one.
pub fn check_bar(
    keys: &PciKeys<'_>,
    partition: &str,
    taken: &mut Taken,
) -> Result<Option<Bar>, Diagnostic> {
    let Some(pci) = keys.pci else {
        let needs_pci = [
            ("bar", keys.bar.as_ref().map(Spanned::span)),
            ("unbind", keys.unbind.as_ref().map(Spanned::span)),
            ("trusted_dma", keys.trusted_dma.as_ref().map(Spanned::span)),
            ("vfio", keys.vfio.as_ref().map(Spanned::span)),
        ];
        for (key, span) in needs_pci {
            if let Some(span) = span {
                let found = format!("`{key}` is about a PCI function, and there is no key `pci`");
                let allowed = format!("`pci = \"0000:00:04.0\"` beside it, or no `{key}`");
                return Err(Diagnostic::new(span, found, allowed));
            }
        }
        return Ok(None);
    };
    let function = parse_function(pci)?;
    let Some(bar) = keys.bar else {
        let found = format!("which register of {function} is not said");
        let allowed = "`bar = 0`, the number of a base address register, 0 to 5";
        return Err(Diagnostic::new(keys.header.clone(), found, allowed));
    };
    let number = *bar.get_ref();
    if !(0..BARS).contains(&number) {
        let found = format!("{number} is not the number of a base address register");
        return Err(Diagnostic::new(bar.span(), found, format!("0 to {}", BARS - 1)));
    }
    take_function(&function, pci, partition, taken)?;
    let is_set = |key: &Option<Spanned<bool>>| key.as_ref().is_some_and(|key| *key.get_ref());
    for (key, name) in [(keys.trusted_dma, "trusted_dma"), (keys.vfio, "vfio")] {
        if let Some(key) = key.as_ref().filter(|key| *key.get_ref()) {
            taken.masters_bus(&function, name, key.span())?;
        }
    }
    Ok(Some(Bar {
        function,
        bar: number as u8,
        unbind: is_set(keys.unbind),
        trusted_dma: is_set(keys.trusted_dma),
        vfio: is_set(keys.vfio),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_function_is_named_as_in_sysfs_and_cannot_leave_its_folder() {
        assert!(PciFunction::parse("0000:00:04.0").is_some());
        assert!(PciFunction::parse("00ff:3a:1f.7").is_some());
        let bad = ["", "00:04.0", "0000:00:04.8", "0000:00:04", "0000:00:0G.0", "0000:00:0A.0"];
        for bad in bad.into_iter().chain(["../../../x.0", "0000/00:04.0", "0000:00:04.0 "]) {
            assert_eq!(PciFunction::parse(bad), None, "{bad}");
        }
    }
}
