//! Each block gives the values of its table.

use crate::table::{Case, Row, Value, tables};
use std::time::Duration;
use takt_blocks::*;

/// A block from its cold start: one call, to the values of the table's columns.
type Step = Box<dyn FnMut(&Row<'_>) -> Vec<Value>>;

fn bools<const N: usize>(row: &Row<'_>) -> [bool; N] {
    std::array::from_fn(|i| row.inputs[i].bool())
}

/// A block with one number in and its results out.
fn number<B: 'static>(mut block: B, step: fn(&mut B, f64, Duration) -> Vec<Value>) -> Step {
    Box::new(move |row| step(&mut block, row.inputs[0].real(), row.elapsed))
}

fn timer(mut step: impl FnMut(bool, Duration, Duration) -> (bool, Duration) + 'static) -> Step {
    Box::new(move |row| {
        let (q, et) = step(row.inputs[0].bool(), row.inputs[1].time(), row.elapsed);
        vec![q.into(), et.into()]
    })
}

fn int(value: Value) -> i16 {
    value.integer().try_into().expect("an INT")
}

fn standard(block: &str) -> Option<Step> {
    Some(match block {
        "Ton" => {
            let mut b = Ton::default();
            timer(move |input, pt, elapsed| (b.update(input, pt, elapsed), b.et()))
        }
        "Tof" => {
            let mut b = Tof::default();
            timer(move |input, pt, elapsed| (b.update(input, pt, elapsed), b.et()))
        }
        "Tp" => {
            let mut b = Tp::default();
            timer(move |input, pt, elapsed| (b.update(input, pt, elapsed), b.et()))
        }
        "Ctu" => {
            let mut b = Ctu::<i16>::default();
            Box::new(move |row| {
                let [cu, reset] = bools(row);
                vec![b.update(cu, reset, int(row.inputs[2])).into(), b.cv().into()]
            })
        }
        "Ctd" => {
            let mut b = Ctd::<i16>::default();
            Box::new(move |row| {
                let [cd, load] = bools(row);
                vec![b.update(cd, load, int(row.inputs[2])).into(), b.cv().into()]
            })
        }
        "Ctud" => {
            let mut b = Ctud::<i16>::default();
            Box::new(move |row| {
                let [cu, cd, reset, load] = bools(row);
                b.update(cu, cd, reset, load, int(row.inputs[4]));
                vec![b.qu().into(), b.qd().into(), b.cv().into()]
            })
        }
        "Sr" => {
            let mut b = Sr::default();
            Box::new(move |row| vec![b.update(row.inputs[0].bool(), row.inputs[1].bool()).into()])
        }
        "Rs" => {
            let mut b = Rs::default();
            Box::new(move |row| vec![b.update(row.inputs[0].bool(), row.inputs[1].bool()).into()])
        }
        "RTrig" => {
            let mut b = RTrig::default();
            Box::new(move |row| vec![b.update(row.inputs[0].bool()).into()])
        }
        "FTrig" => {
            let mut b = FTrig::default();
            Box::new(move |row| vec![b.update(row.inputs[0].bool()).into()])
        }
        _ => return None,
    })
}

fn continuous(block: &str, case: &Case) -> Option<Step> {
    let real = |name| case.real(name);
    Some(match block {
        "Limiter" => number(Limiter::new(real("low"), real("high")), |b, value, _| {
            vec![b.update(value).into(), b.at_low().into(), b.at_high().into()]
        }),
        "DeadBand" => {
            number(DeadBand::new(real("width")), |b, value, _| vec![b.update(value).into()])
        }
        "Hysteresis" => number(Hysteresis::new(real("low"), real("high")), |b, value, _| {
            vec![b.update(value).into()]
        }),
        "Scale" => number(
            Scale::new(real("in_low"), real("in_high"), real("out_low"), real("out_high")),
            |b, value, _| vec![b.update(value).into()],
        ),
        "Lag" => number(Lag::new(real("time_constant")), |b, value, elapsed| {
            vec![b.update(value, elapsed).into()]
        }),
        "SecondOrder" => {
            number(SecondOrder::new(real("frequency"), real("damping")), |b, value, elapsed| {
                vec![b.update(value, elapsed).into(), b.rate().into()]
            })
        }
        "Ramp" => number(Ramp::new(real("up"), real("down"), 0.0), |b, value, elapsed| {
            vec![b.update(value, elapsed).into()]
        }),
        "Biquad" => {
            let [b0, b1, b2, a1, a2] = ["b0", "b1", "b2", "a1", "a2"].map(real);
            number(Biquad::new(Coefficients { b0, b1, b2, a1, a2 }), |b, value, _| {
                vec![b.update(value).into()]
            })
        }
        "Fir" => number(Fir::new(["c0", "c1", "c2", "c3"].map(real)), |b, value, _| {
            vec![b.update(value).into()]
        }),
        "Delay" => {
            let calls = case.set["calls"].integer().try_into().expect("a number of calls");
            number(Delay::<4>::new(calls), |b, value, _| vec![b.update(value).into()])
        }
        "Statistics" => number(Statistics::<4>::new(), |b, value, _| {
            b.update(value);
            vec![
                b.mean().into(),
                b.standard_deviation().into(),
                b.least().into(),
                b.greatest().into(),
            ]
        }),
        "Fft" => Box::new(|row| {
            let mut values: Vec<f64> = row.inputs.iter().map(|value| value.real()).collect();
            let (real, imaginary) = values.split_at_mut(row.inputs.len() / 2);
            fft::transform(real, imaginary).expect("a power of two");
            values.into_iter().map(Value::from).collect()
        }),
        _ => return None,
    })
}

fn supervising(block: &str, case: &Case) -> Option<Step> {
    let real = |name| case.real(name);
    Some(match block {
        "Pid" => {
            let mut b = Pid::new(Tuning {
                proportional: real("proportional"),
                integral: real("integral"),
                derivative: real("derivative"),
                derivative_filter: real("derivative_filter"),
                low: real("low"),
                high: real("high"),
            });
            Box::new(move |row| {
                let (set, measured) = (row.inputs[0].real(), row.inputs[1].real());
                let output = if row.inputs[2].bool() {
                    b.update(set, measured, row.elapsed)
                } else {
                    b.track(row.inputs[3].real(), set, measured, row.elapsed)
                };
                vec![output.into()]
            })
        }
        "Alarm" => {
            let condition = match case.set["condition"].integer() {
                0 => Condition::Above,
                1 => Condition::Below,
                2 => Condition::Equal,
                _ => Condition::Different,
            };
            let mut b = Alarm::new(condition, real("limit"))
                .with_dead_band(real("dead_band"))
                .with_delays(case.set["on_delay"].time(), case.set["off_delay"].time());
            Box::new(move |row| {
                let state = b.update(row.inputs[0].real(), row.inputs[1].bool(), row.elapsed);
                vec![Value::Integer(state as i64)]
            })
        }
        "Multiplexer" => {
            let mut b = Multiplexer::default();
            Box::new(move |row| {
                let select = row.inputs[0].integer().try_into().expect("a number");
                let inputs: Vec<f64> = row.inputs[1..].iter().map(|value| value.real()).collect();
                let output = b.update(select, &inputs).expect("there are inputs");
                vec![output.into(), b.out_of_range().into()]
            })
        }
        _ => return None,
    })
}

#[test]
fn each_block_gives_the_values_of_its_table() {
    let tables = tables();
    assert!(tables.len() >= 25, "only {} tables", tables.len());
    for (file, table) in &tables {
        for case in &table.cases {
            let mut step = standard(&table.block)
                .or_else(|| continuous(&table.block, case))
                .or_else(|| supervising(&table.block, case))
                .unwrap_or_else(|| panic!("no block {}", table.block));
            for (number, row) in case.rows(table).enumerate() {
                let found = step(&row);
                let near = found.len() == row.outputs.len()
                    && found.iter().zip(row.outputs).all(|(a, b)| a.near(*b, case.tolerance));
                assert!(
                    near,
                    "{file}, {:?}, row {}: found {found:?}, expected {:?}",
                    case.name,
                    number + 1,
                    row.outputs
                );
            }
        }
    }
}
