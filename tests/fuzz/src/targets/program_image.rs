//! Program images. They come from the tool of the program's author, over a USB stick or a network.

use takt_program::{Area, Image, Type, TypeKind};

/// Reads an image, and everything in it if it is accepted. The hash is left out: the fuzzer would never get
/// past it, and somebody who means harm would set it right.
///
/// # Panics
/// If what was accepted is not inside of the file, of its area, or of its limits.
pub fn run(data: &[u8]) {
    let Ok(image) = Image::parse(data) else { return };
    for variable in image.variables() {
        let end = u64::from(variable.offset) + u64::from(variable.bytes);
        assert!(end <= image.area_bytes(variable.area).into(), "{}", variable.name);
        let found = image.variable(variable.name).expect("a name that is there is found");
        assert_eq!(found.index, variable.index);
        let ty = image.type_of(variable.ty).expect("a variable has a type");
        assert!(parts(&image, &ty, 0) <= u64::from(ty.bytes), "{}", variable.name);
    }
    for task in image.tasks() {
        assert!((task.entry.0 as usize) < image.code().len());
        assert!(task.stack_bytes <= takt_program::limit::STACK_BYTES);
    }
    for trap in image.traps() {
        assert_eq!(image.trap(trap.at).map(|found| found.kind), Some(trap.kind));
    }
    for line in image.lines() {
        assert_eq!(image.line(line.at), Some(line).filter(|line| line.line != 0));
    }
    assert!(image.state().len() <= image.area_bytes(Area::State) as usize);
    let _ = (image.objects().count(), image.ports().count(), Image::verify(data).is_ok());
}

/// How many parts without parts a value has, with each array counted as one element.
fn parts(image: &Image<'_>, ty: &Type<'_>, depth: u16) -> u64 {
    assert!(depth < takt_program::limit::TYPE_DEPTH);
    let part = |id| image.type_of(id).map_or(0, |part| parts(image, &part, depth + 1));
    match ty.kind {
        TypeKind::Array { element, .. } => part(element),
        TypeKind::Structure | TypeKind::FunctionBlock => {
            image.fields(ty).map(|field| part(field.ty)).sum()
        }
        _ => 1,
    }
}
