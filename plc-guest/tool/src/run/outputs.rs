//! What of the outputs leaves a task.

use takt_program::{Area, Image, TaskId, Variable, address};

use super::memory::Memory;

/// The outputs of a program whose tasks share one image of them here, where the guest has a view for each task.
pub struct Outputs<'a> {
    image: Image<'a>,
    /// A one for each bit that a task writes, in a program of several tasks. What else is written never leaves the
    /// view of a task there. One task alone writes all.
    written: Option<Vec<u8>>,
}

impl<'a> Outputs<'a> {
    /// Those of an image, of which so many tasks are the program's own.
    pub fn new(image: Image<'a>, own: usize) -> Self {
        let written = (own > 1).then(|| {
            let mut map = vec![0; image.area_bytes(Area::Output) as usize];
            for output in outputs(&image).filter(|output| output.writer.is_some()) {
                for byte in map.iter_mut().skip(output.offset as usize).take(bytes(&output)) {
                    *byte |= mask(&output);
                }
            }
            map
        });
        Self { image, written }
    }

    /// As they are.
    pub fn get(&self, memory: &Memory) -> Vec<u8> {
        memory.get(address::OUTPUT, self.image.area_bytes(Area::Output).into()).unwrap_or_default()
    }

    /// An output of another task that is not as it was.
    pub fn foreign(&self, memory: &Memory, before: &[u8], task: TaskId) -> Option<&'a str> {
        let after = self.get(memory);
        let mut foreign = outputs(&self.image)
            .filter(|output| output.writer.is_some_and(|writer| writer != task));
        let changed = foreign.find(|output| {
            let from = output.offset as usize;
            (from..from + bytes(output)).any(|at| {
                let [old, new] = [before, &after].map(|image| image.get(at).copied().unwrap_or(0));
                (old ^ new) & mask(output) != 0
            })
        });
        changed.map(|output| output.name)
    }

    /// Puts back what a job has written of outputs that no task writes.
    pub fn restore(&self, memory: &Memory, before: &[u8]) {
        let Some(written) = &self.written else { return };
        let after = self.get(memory);
        let kept = after.iter().zip(before).zip(written);
        let kept: Vec<u8> = kept.map(|((new, old), map)| new & map | old & !map).collect();
        if kept != after {
            memory.put(address::OUTPUT, &kept);
        }
    }
}

fn outputs<'a>(image: &Image<'a>) -> impl Iterator<Item = Variable<'a>> + use<'a> {
    image.variables().filter(|variable| variable.area == Area::Output)
}

fn bytes(output: &Variable<'_>) -> usize {
    output.bytes as usize
}

fn mask(output: &Variable<'_>) -> u8 {
    output.bit.map_or(u8::MAX, |bit| 1 << bit)
}

#[cfg(test)]
mod tests {
    use takt_program::build::{self, Builder, When};
    use takt_program::{CodeOffset, Elementary, Nanoseconds};

    use super::*;
    use crate::run::memory::Rights;

    /// An image of these tasks, with an output of the first in byte 0 and in bit 1 of byte 1, and others of no task.
    fn image(tasks: usize) -> Vec<u8> {
        let mut builder = Builder::new("p");
        builder.code = vec![0xc3];
        builder.output_bytes = 3;
        let writer = Some(TaskId(0));
        let flags = takt_program::Flags::OUTPUT;
        for (name, elementary, offset, bit, writer) in [
            ("own", Elementary::Byte, 0, None, writer),
            ("lamp", Elementary::Bool, 1, Some(1), writer),
            ("horn", Elementary::Bool, 1, Some(2), None),
            ("shared", Elementary::Byte, 2, None, None),
        ] {
            let ty = builder.elementary(elementary);
            let output = build::Variable::new(name, ty, Area::Output, offset);
            builder.variable(build::Variable { bit, writer, flags, ..output });
        }
        for number in 0..tasks {
            let when = When::Cyclic { period: Nanoseconds(1_000_000), offset: Nanoseconds(0) };
            builder.task(build::Task::new(&format!("t{number}"), when, CodeOffset(0)));
        }
        builder.build().unwrap()
    }

    #[test]
    fn of_several_tasks_only_what_one_of_them_writes_stays() {
        // With two tasks of which one is a test's, as with one, all stays.
        for (tasks, own, left) in [(2, 2, [7, 2, 0]), (2, 1, [7, 6, 9]), (1, 1, [7, 6, 9])] {
            let bytes = image(tasks);
            let image = Image::verify(&bytes).unwrap();
            let memory = Memory::new(&image, Rights::Read).unwrap();
            let outputs = Outputs::new(image, own);
            let before = outputs.get(&memory);
            memory.put(address::OUTPUT, &[7, 6, 9]);
            let first = outputs.foreign(&memory, &before, TaskId(0));
            assert_eq!((first, outputs.foreign(&memory, &before, TaskId(1))), (None, Some("lamp")));
            outputs.restore(&memory, &before);
            assert_eq!(outputs.get(&memory), left);
        }
    }
}
