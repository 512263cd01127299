//! Formulas: the published ones term by term, and every formula evaluated from its text and compared with the sum of twists.

use std::collections::BTreeMap;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::{
    Chain, ErrorMotion, Form, GivenErrors, MotionFrame, State, volumetric_error,
};
use volcomp_sensitivity::{Expression, terms};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::{AxisKind, Component, ErrorName};

/// Formula of the two-axis mechanism in Procedia Engineering 24 (2011) 845–849.
#[test]
fn the_published_mechanism_comes_out_term_by_term() {
    let mut chain = Chain::new("w b X Y t".parse().unwrap());
    chain.set_tool([120.0, 80.0, 0.0], [0.0, 0.0, 1.0]).unwrap();
    let expression = Expression::of(&chain, &terms(&chain, true, &[]));
    let expected = [
        "dX = EXX + SXX + EXY + SXY - (y + Yt)*(ECX + SCX + SCY) - Yt*ECY",
        "dY = EYX + SYX + EYY + SYY + Xt*(ECX + ECY + SCY) + (x + Xt)*SCX",
        "dZ = EZX + SZX + EZY + SZY + (y + Yt)*(EAX + SAX + SAY) - Xt*(EBX + EBY + SBY) - (x + Xt)*SBX + Yt*EAY",
        "dA = EAX + SAX + EAY + SAY",
        "dB = EBX + SBX + EBY + SBY",
        "dC = ECX + SCX + ECY + SCY",
    ];
    assert_eq!(expression.text(), expected);
    let [x, ..] = expression.latex();
    assert_eq!(
        x,
        "\\Delta x &= E_{XX} + S_{XX} + E_{XY} + S_{XY} - (y + Y_t)\\,(E_{CX} + S_{CX} + S_{CY}) - Y_t\\,E_{CY}"
    );
}

/// Parses `2.5*x*cos(a) - (y + Yt)*(EXX - EYX)` like Python.
struct Reader<'a> {
    text: &'a str,
    values: &'a BTreeMap<String, f64>,
}

impl Reader<'_> {
    fn peek(&mut self) -> Option<char> {
        self.text = self.text.trim_start();
        self.text.chars().next()
    }

    fn takes(&mut self, sign: char) -> bool {
        let found = self.peek() == Some(sign);
        if found {
            self.text = &self.text[sign.len_utf8()..];
        }
        found
    }

    fn sum(&mut self) -> f64 {
        let mut sum = if self.takes('-') { -self.product() } else { self.product() };
        loop {
            if self.takes('+') {
                sum += self.product();
            } else if self.takes('-') {
                sum -= self.product();
            } else {
                return sum;
            }
        }
    }

    fn product(&mut self) -> f64 {
        let mut product = self.atom();
        while self.takes('*') {
            product *= self.atom();
        }
        product
    }

    fn atom(&mut self) -> f64 {
        if self.takes('(') {
            let sum = self.sum();
            assert!(self.takes(')'), "{}", self.text);
            return sum;
        }
        self.peek();
        let end =
            self.text.find(|c: char| !(c.is_alphanumeric() || c == '.')).unwrap_or(self.text.len());
        let (word, rest) = self.text.split_at(end);
        self.text = rest;
        if word == "sin" || word == "cos" {
            let of = self.atom();
            return if word == "sin" { of.sin() } else { of.cos() };
        }
        match word.parse() {
            Ok(number) => number,
            Err(_) => *self.values.get(word).unwrap_or_else(|| panic!("{word}")),
        }
    }
}

fn random_motion(rng: &mut ChaCha8Rng) -> ErrorMotion {
    let six = [20.0, 20.0, 20.0, 30.0, 30.0, 30.0];
    ErrorMotion::from_um_urad(six.map(|size| rng.random_range(-size..=size)))
}

fn parts(motion: &ErrorMotion) -> [f64; 6] {
    let (l, a) = (motion.linear_mm, motion.angular_rad);
    [l.x, l.y, l.z, a.x, a.y, a.z]
}

#[test]
fn every_printed_formula_is_the_sum_of_twists() {
    let mut rng = ChaCha8Rng::seed_from_u64(91);
    for (index, structure) in all_types().into_iter().enumerate() {
        let mut chain = Chain::new(structure.clone());
        let mut vector = |size: f64| [(); 3].map(|()| rng.random_range(-size..=size));
        chain.set_tool(vector(200.0), [0.0, 0.0, 1.0]).unwrap();
        for &axis in structure.axes() {
            chain.set_point(axis, vector(300.0)).unwrap();
            if index % 3 == 1 {
                chain.set_direction(axis, vector(1.0)).unwrap();
            }
            if axis.is_rotary() && index % 2 == 1 {
                chain.set_motion_frame(axis, MotionFrame::Turning).unwrap();
            }
        }
        let locations: Vec<ErrorName> = structure
            .axes()
            .iter()
            .flat_map(|&axis| Component::ALL.map(|component| ErrorName::location(component, axis)))
            .collect();
        let errors = terms(&chain, true, &locations);
        let expression = Expression::of(&chain, &errors);
        let text = expression.text();
        for _ in 0..5 {
            let (mut given, mut state) = (GivenErrors::default(), State::default());
            let mut values = BTreeMap::new();
            for (place, tip) in chain.tool_tip_mm().iter().enumerate() {
                values.insert(format!("{}t", ['X', 'Y', 'Z'][place]), *tip);
            }
            for (axis, joint) in chain.joints().iter().enumerate() {
                state.q[axis] = match joint.kind {
                    AxisKind::Linear => rng.random_range(-400.0..=400.0),
                    AxisKind::Rotary => rng.random_range(-3.0..=3.0),
                };
                let letter = joint.name.to_string().to_lowercase();
                values.insert(letter, state.q[axis]);
                given.motion[axis] = random_motion(&mut rng);
                given.assembly[axis] = random_motion(&mut rng);
                let motion = parts(&given.motion[axis]);
                let assembly = parts(&given.assembly[axis]);
                for component in Component::ALL {
                    let (k, name) = (component.index(), joint.name);
                    values.insert(ErrorName::motion(component, name).to_string(), motion[k]);
                    values.insert(format!("S{}{name}", component.letter()), assembly[k]);
                    if joint.no_effect(component).is_none() {
                        let location = ErrorName::location(component, name);
                        given.set(&chain, location, rng.random_range(-20.0..=20.0)).unwrap();
                        values.insert(location.to_string(), parts(&given.location[axis])[k]);
                    }
                }
            }
            let twist = volumetric_error(&chain, &given, &state, Form::Twist);
            let expected = [twist.position_mm.as_slice(), twist.rotation_rad.as_slice()].concat();
            let ours = expression.value(&chain, &given, &state);
            // The tolerance is relative to the whole vector, because a component may almost cancel.
            let size = [twist.position_mm.norm(), twist.rotation_rad.norm()];
            for (k, line) in text.iter().enumerate() {
                let (_, formula) = line.split_once(" = ").unwrap();
                let mut reader = Reader { text: formula, values: &values };
                let read = reader.sum();
                assert_eq!(reader.peek(), None, "{line}");
                for value in [read, ours[k]] {
                    let off = (value - expected[k]).abs() / size[k / 3];
                    assert!(off < 1e-12, "{structure} {line}: {off}");
                }
            }
        }
    }
}
