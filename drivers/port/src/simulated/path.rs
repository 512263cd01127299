//! Positions along the moves of a part program, as a function of time.

use std::time::Duration;

use volcomp_vocabulary::PerChannel;

#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Move {
    /// End point, mm and rad.
    pub to: PerChannel<f64>,
    /// Speed along the path, mm/s, or rad/s if no linear axis moves.
    pub feed_per_s: f64,
    /// Time for which the axes stay at the end point.
    pub dwell: Duration,
}

/// Positions along a repeated part program, as a function of time. All moves have the same acceleration and
/// deceleration.
#[derive(Clone, Debug)]
pub struct Path {
    segments: Vec<Segment>,
    /// Start time of each segment, s. The last element is the end of the last dwell.
    starts_s: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Segment {
    from: PerChannel<f64>,
    to: PerChannel<f64>,
    length: f64,
    /// Duration of the acceleration, and of the equally long deceleration, s.
    accelerating_s: f64,
    coasting_s: f64,
    acceleration: f64,
}

impl Path {
    /// Creates a path that repeats these moves. The acceleration and deceleration is in mm/s², or rad/s² if no linear
    /// axis moves. The path starts at the end point of the last move.
    pub fn new(program: &[Move], acceleration: f64) -> Self {
        let mut from = program.last().map_or(PerChannel::ZERO, |last| last.to);
        let (mut segments, mut starts_s) = (Vec::new(), vec![0.0]);
        for step in program {
            let segment = Segment::new(from, step, acceleration);
            let before = starts_s[starts_s.len() - 1];
            starts_s.push(before + segment.duration_s() + step.dwell.as_secs_f64());
            segments.push(segment);
            from = step.to;
        }
        Self { segments, starts_s }
    }

    /// Time from the start to the arrival at the end point of the move with this index from 0; `None` if there is no
    /// such move.
    pub fn arrival(&self, index: usize) -> Option<Duration> {
        let (segment, start_s) = (self.segments.get(index)?, self.starts_s.get(index)?);
        Duration::try_from_secs_f64(start_s + segment.duration_s()).ok()
    }

    /// Positions of the axes, mm and rad. `elapsed` is the time since the start.
    pub fn at(&self, elapsed: Duration) -> PerChannel<f64> {
        let period = self.starts_s[self.starts_s.len() - 1];
        let time = if period > 0.0 { elapsed.as_secs_f64() % period } else { 0.0 };
        let index = self.starts_s.partition_point(|start| *start <= time);
        let place = index.saturating_sub(1).min(self.segments.len().saturating_sub(1));
        let segment = self.segments.get(place);
        segment.map_or(PerChannel::ZERO, |s| s.at(time - self.starts_s[place]))
    }
}

impl Segment {
    fn new(from: PerChannel<f64>, step: &Move, acceleration: f64) -> Self {
        let squares = from.iter().zip(&step.to).map(|(a, b)| (b - a) * (b - a));
        let length = squares.sum::<f64>().sqrt();
        // A short move does not reach its feed.
        let feed = step.feed_per_s.min((length * acceleration).sqrt());
        let (accelerating_s, coasting_s) = if length > 0.0 && feed > 0.0 {
            let accelerating_s = feed / acceleration;
            (accelerating_s, length / feed - accelerating_s)
        } else {
            (0.0, 0.0)
        };
        Self { from, to: step.to, length, accelerating_s, coasting_s, acceleration }
    }

    fn duration_s(&self) -> f64 {
        2.0 * self.accelerating_s + self.coasting_s
    }

    fn at(&self, time_s: f64) -> PerChannel<f64> {
        let left_s = self.duration_s() - time_s;
        let passed = if self.length == 0.0 || left_s <= 0.0 {
            return self.to;
        } else if time_s < self.accelerating_s {
            0.5 * self.acceleration * time_s * time_s
        } else if left_s < self.accelerating_s {
            self.length - 0.5 * self.acceleration * left_s * left_s
        } else {
            let feed = self.acceleration * self.accelerating_s;
            feed * (time_s - 0.5 * self.accelerating_s)
        };
        let share = passed / self.length;
        PerChannel::from_fn(|i| self.from[i] + share * (self.to[i] - self.from[i]))
    }
}
