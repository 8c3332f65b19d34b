//! Words that a command line adds to a guest's.
//!
//! What a guest is to do during one run, such as which load to make, belongs to that run and not
//! to the file. A changed copy of the file would be the other way, but the paths in it are relative
//! to its place, and the lines of a message are those of the copy.

use thiserror::Error;

use super::values::CMDLINE_MAX;
use super::{Kind, PartitionFile};

/// Why words cannot be added to the command lines of the file's Linuxes.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum AppendError {
    /// No partition has a command line.
    #[error("--append: the file has no partition of kind \"linux\"")]
    NoLinux,
    /// The kernel would cut it.
    #[error(
        "--append: the command line of partition \"{partition}\" would have {length} bytes, and \
         {CMDLINE_MAX} are the most"
    )]
    TooLong {
        /// Whose.
        partition: String,
        /// With the words added.
        length: usize,
    },
    /// The file may not have one either.
    #[error("--append: the control character {0:?} cannot be on a command line")]
    Control(char),
}

impl PartitionFile {
    /// Adds `words` to the kernel command line of each Linux partition, with a space between.
    ///
    /// # Errors
    /// [`AppendError`]; nothing is changed then.
    pub fn append(&mut self, words: &str) -> Result<(), AppendError> {
        if let Some(control) = words.chars().find(|c| c.is_control()) {
            return Err(AppendError::Control(control));
        }
        let mut longer = Vec::new();
        for partition in &self.partitions {
            let Kind::Linux { cmdline, .. } = &partition.kind else { continue };
            let length = cmdline.len() + 1 + words.len();
            if length > CMDLINE_MAX {
                let partition = partition.name.clone();
                return Err(AppendError::TooLong { partition, length });
            }
            longer.push(format!("{cmdline} {words}"));
        }
        if longer.is_empty() {
            return Err(AppendError::NoLinux);
        }
        let cmdlines = self.partitions.iter_mut().filter_map(|p| match &mut p.kind {
            Kind::Linux { cmdline, .. } => Some(cmdline),
            Kind::Plc { .. } => None,
        });
        cmdlines.zip(longer).for_each(|(cmdline, longer)| *cmdline = longer);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::load;

    const WITH_LINUX: &str = "good/plc-and-linux.toml";

    fn file(name: &str) -> PartitionFile {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/partition_files");
        load(&folder.join(name), None).unwrap()
    }

    fn cmdline(file: &PartitionFile) -> &str {
        let cmdline = file.partitions().iter().find_map(|p| match p.kind() {
            Kind::Linux { cmdline, .. } => Some(cmdline),
            Kind::Plc { .. } => None,
        });
        cmdline.unwrap()
    }

    #[test]
    fn words_come_behind_those_of_the_file_as_far_as_the_kernel_keeps_them() {
        let mut file = file(WITH_LINUX);
        let before = cmdline(&file).to_owned();
        file.append("takt.load=cpu").unwrap();
        assert_eq!(cmdline(&file), format!("{before} takt.load=cpu"));
        let room = CMDLINE_MAX - cmdline(&file).len() - 1;
        let too_long = file.append(&"x".repeat(room + 1)).unwrap_err();
        let partition = "linux".to_owned();
        assert_eq!(too_long, AppendError::TooLong { partition, length: CMDLINE_MAX + 1 });
        file.append(&"x".repeat(room)).unwrap();
        assert_eq!(cmdline(&file).len(), CMDLINE_MAX);
    }

    #[test]
    fn each_linux_gets_the_words_or_none_does() {
        let mut both = file("good/two-linuxes-on-a-cpu.toml");
        let cmdlines = |file: &PartitionFile| {
            let cmdlines = file.partitions().iter().filter_map(|p| match p.kind() {
                Kind::Linux { cmdline, .. } => Some(cmdline.clone()),
                Kind::Plc { .. } => None,
            });
            cmdlines.collect::<Vec<_>>()
        };
        both.append("quiet").unwrap();
        assert_eq!(cmdlines(&both), ["console=ttyS0 quiet", "console=ttyS0 quiet"]);
        assert!(both.append(&"x".repeat(CMDLINE_MAX)).is_err());
        assert_eq!(cmdlines(&both), ["console=ttyS0 quiet", "console=ttyS0 quiet"]);
    }

    #[test]
    fn only_a_linux_has_a_command_line_and_it_is_one_line() {
        assert_eq!(file("good/plc-alone.toml").append("quiet"), Err(AppendError::NoLinux));
        assert_eq!(file(WITH_LINUX).append("a\nb"), Err(AppendError::Control('\n')));
    }
}
