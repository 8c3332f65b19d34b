//! Outputs of two versions, beside each other.

use takt_points::{Point, Value, matches};
use takt_protocol::Area;

use super::Outputs;

/// How far an output of the new version may be from the running one's.
#[derive(Clone, Debug, PartialEq)]
pub struct Tolerance {
    /// The outputs that it is for, by name; `*` is any text. None: all.
    pub name: Option<String>,
    pub most: f64,
}

impl std::str::FromStr for Tolerance {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, number) = match text.split_once('=') {
            Some((name, number)) => (Some(name.trim().to_owned()), number),
            None => (None, text),
        };
        let most = number.trim().parse().ok().filter(|most: &f64| *most >= 0.0);
        let most = most.ok_or_else(|| {
            format!(
                "found `{}`; allowed: a number from 0 on, alone or as NAME=NUMBER",
                number.trim()
            )
        })?;
        Ok(Self { name, most })
    }
}

/// What became of an output.
#[derive(Clone, Debug)]
pub struct Output {
    pub point: Point,
    /// Largest difference that is allowed.
    pub tolerance: f64,
    /// Largest difference, infinite where values have none, and its cycle; none while there is none.
    pub largest: Option<(f64, u64)>,
    /// First cycle out of tolerance, and how many there are.
    pub first_out: Option<u64>,
    pub cycles_out: u64,
    /// Of a number: most cycles in a row in which the running version's moved and the new one's stood still. A
    /// controller whose integrator is saturated shows so.
    pub still: u64,
    motion: Motion,
}

/// How an output has moved lately.
#[derive(Clone, Debug, Default)]
struct Motion {
    /// The cycle, and what the output was then.
    last: Option<(u64, Value, Value)>,
    /// Cycles of this stretch.
    stretch: u64,
}

impl Motion {
    /// Takes the values of the next cycle; the length of the stretch that they belong to.
    fn take(&mut self, cycle: u64, running: Value, new: Value) -> u64 {
        let last = self.last.replace((cycle, running, new));
        self.stretch = match last {
            Some((at, before, new_before)) if at + 1 == cycle && new_before == new => {
                self.stretch + u64::from(before != running)
            }
            _ => 0,
        };
        self.stretch
    }
}

/// All outputs of a program.
#[derive(Clone, Debug)]
pub struct Comparison {
    pub outputs: Vec<Output>,
}

impl Comparison {
    /// Of those among these points that are outputs. The last tolerance that means an output counts.
    ///
    /// # Errors
    /// The name of a tolerance that means no output.
    pub fn new(points: Vec<Point>, tolerances: &[Tolerance]) -> Result<Self, String> {
        let points: Vec<Point> =
            points.into_iter().filter(|point| point.range.area == Area::Output).collect();
        let means = |name: &Option<String>, point: &Point| {
            name.as_ref().is_none_or(|name| matches(name, &point.name))
        };
        let idle = tolerances.iter().find(|t| !points.iter().any(|point| means(&t.name, point)));
        if let Some(Tolerance { name: Some(name), .. }) = idle {
            return Err(name.clone());
        }
        let output = |point: Point| {
            let tolerance = tolerances.iter().rev().find(|t| means(&t.name, &point));
            let tolerance = tolerance.map_or(0.0, |tolerance| tolerance.most);
            Output {
                point,
                tolerance,
                largest: None,
                first_out: None,
                cycles_out: 0,
                still: 0,
                motion: Motion::default(),
            }
        };
        Ok(Self { outputs: points.into_iter().map(output).collect() })
    }

    /// Takes the outputs of a cycle.
    pub fn take(&mut self, both: &Outputs) {
        for output in &mut self.outputs {
            let range = output.point.range;
            let bytes = range.offset as usize..range.offset as usize + usize::from(range.bytes);
            let [running, new] =
                [&both.running, &both.new].map(|all| all.get(bytes.clone()).unwrap_or_default());
            let values = output.point.value(running).zip(output.point.value(new));
            if let Some((running, new)) = values.filter(|(value, _)| is_number(value)) {
                output.still = output.still.max(output.motion.take(both.cycle, running, new));
            }
            let difference = match (output.point.bit, values) {
                (None, _) if running == new => continue,
                (_, Some((running, new))) => difference(running, new),
                (_, None) => f64::INFINITY,
            };
            if difference > 0.0 && output.largest.is_none_or(|(most, _)| difference > most) {
                output.largest = Some((difference, both.cycle));
            }
            if difference > output.tolerance {
                output.cycles_out += 1;
                output.first_out.get_or_insert(both.cycle);
            }
        }
    }

    /// Whether each output stayed within its tolerance.
    pub fn is_within(&self) -> bool {
        self.outputs.iter().all(|output| output.cycles_out == 0)
    }
}

/// Whether a value can move by a little.
fn is_number(value: &Value) -> bool {
    matches!(value, Value::Signed(_) | Value::Unsigned(_) | Value::Float(_))
}

/// How far two values of a type are from each other.
fn difference(a: Value, b: Value) -> f64 {
    match (a, b) {
        (Value::Signed(a), Value::Signed(b)) | (Value::Duration(a), Value::Duration(b)) => {
            a.abs_diff(b) as f64
        }
        (Value::Unsigned(a), Value::Unsigned(b)) => a.abs_diff(b) as f64,
        (Value::Float(a), Value::Float(b)) if a == b || a.is_nan() && b.is_nan() => 0.0,
        (Value::Float(a), Value::Float(b)) if (a - b).is_finite() => (a - b).abs(),
        (Value::Bool(a), Value::Bool(b)) if a == b => 0.0,
        _ => f64::INFINITY,
    }
}
