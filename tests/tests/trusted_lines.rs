//! The code that runs on the host while guests do does not grow unnoticed.

use std::path::Path;

use takt_tests::trusted_lines::by_folder;

/// Most lines of each folder. A change that needs more raises the number and says in its commit what the lines are for.
/// A change that needs fewer lowers it.
const MOST: [(&str, usize); 13] = [
    ("vmm/src", 19_034),
    ("vmm/plan/src", 8_728),
    ("vmm/host/src", 640),
    ("vmm/record/src", 304),
    ("vmm/retain/src", 530),
    ("vmm/figures/src", 1_811),
    ("vmm/protocol/src", 730),
    ("scheduler/src", 2_335),
    ("devices/src", 1_834),
    ("devices/channel/src", 1_220),
    ("devices/abi/src", 1_115),
    ("plc-guest/program/src", 2_640),
    ("plc-guest/change/src", 2_161),
];

#[test]
fn no_folder_of_trusted_code_has_more_lines_than_it_may() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("tests/ is in the project");
    let folders = by_folder(root).expect("the sources are readable");
    for ((folder, _, lines), (limited, most)) in folders.into_iter().zip(MOST) {
        assert_eq!(folder, limited);
        assert!(lines <= most, "{folder} has {lines} lines of code to trust, and may have {most}");
        // A limit that is far away holds nothing.
        assert!(
            lines + lines / 10 + 20 >= most,
            "{folder} has {lines} lines; lower its limit of {most}"
        );
    }
}
