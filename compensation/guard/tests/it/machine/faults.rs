//! What may go wrong with a machine and the ways to it, drawn at random, and how it is mended.

use super::*;

impl Machine {
    /// A random thing happens: any fault, any request, or that all is well.
    pub(crate) fn happens(&mut self) -> Option<Request> {
        let index = self.random.random_range(0..self.ways.len());
        let now = self.now;
        match self.random.random_range(0..64) {
            0 | 1 => self.ways[index].online ^= true,
            2 => self.interlock.emergency_stop ^= true,
            3 => self.interlock.alarm ^= true,
            4 => self.interlock.unreferenced ^= true,
            5 => self.ways[index].frozen_at = self.ways[index].frozen_at.xor(Some(now)),
            6..10 => self.requested = Some(self.any_wanted()),
            10 => self.requested = None,
            11 => {
                let mut requested = self.any_wanted();
                requested.position[0] = f64::NAN;
                self.requested = Some(requested);
            }
            12 => {
                let is_nan = self.random.random();
                self.positions[0] = if is_nan { f64::NAN } else { f64::INFINITY };
            }
            13 => self.positions[0] = self.random.random_range(-1e3..1e3),
            14 => self.others_write(),
            15 => return Some(Request::Disarm),
            16 => return Some(Request::Switched),
            17 => return Some(Request::Acknowledge),
            18 => {
                self.forbids = if self.forbids.is_empty() {
                    Reasons::AUDIT
                } else {
                    Reasons::NONE
                }
            }
            19 => self.ways[index].loses = self.kind == Kind::Lossy || self.kind == Kind::Barrier,
            20 => {
                self.ways[index].fails = true;
                self.ways[index].loses = match self.kind {
                    Kind::Late => false,
                    Kind::Lines | Kind::LinesWithTimeOut => true,
                    Kind::Lossy | Kind::Barrier => self.random.random(),
                };
            }
            21 => self.ways[index].hides_applied ^= true,
            22 => self.really_includes ^= true,
            23..27 => self.lies(index),
            27..31 => {
                let most = match self.kind {
                    Kind::Late => OLDEST,
                    Kind::Lossy => self.limits.delay(),
                    _ => Duration::ZERO,
                };
                self.ways[index].late = most.mul_f64(self.random.random());
            }
            31..34 => self.change_limits(),
            34 => self.power_up(),
            35 => self.restart(),
            36 => {
                let mut often = || [0.0, 0.05, 0.3][self.random.random_range(0..3)];
                self.channel = Channel {
                    lost: often(),
                    late: often(),
                    doubled: often(),
                    torn: often(),
                };
            }
            37..50 => return Some(Request::Arm),
            50..56 => self.all_is_well(),
            _ => {}
        }
        None
    }

    pub(crate) fn all_is_well(&mut self) {
        self.interlock = Interlock::default();
        self.channel = Channel::default();
        self.forbids = Reasons::NONE;
        self.positions[0] = 0.0;
        self.requested = Some(self.any_wanted());
        for way in &mut self.ways {
            (way.online, way.hides_applied, way.loses, way.fails) = (true, false, false, false);
            (way.frozen_at, way.lie, way.spoils_word) = (None, None, None);
        }
    }

    /// All is well, readings come at once, and the axes may go as fast as they ever might.
    pub(crate) fn is_mended(&mut self) {
        self.all_is_well();
        for way in &mut self.ways {
            way.late = Duration::ZERO;
        }
        let full = full_limits(self.limits.count);
        for i in self.axes() {
            self.limits.axes[i] = AxisLimits {
                includes_correction: self.limits.axes[i].includes_correction,
                ..full.axes[i]
            };
        }
        self.limits.ramp = full.ramp;
        self.guard.set_limits(self.limits).expect("good limits");
        (self.really_includes, self.seen.began) = (self.limits.axes[0].includes_correction, true);
    }

    /// One reading is torn, of another axis, no number, or far off.
    fn lies(&mut self, index: usize) {
        let mut lie = self.applied;
        match self.random.random_range(0..4) {
            0 => lie.swap(0, 1),
            1 => lie[0] += 0.256,
            2 => lie[0] = f64::NAN,
            _ => lie[0] = self.random.random_range(-70.0..70.0),
        }
        self.ways[index].lie = Some(lie);
        let bits = 1 << self.random.random_range(0..16_u16);
        self.ways[index].spoils_word = Some((self.random.random_range(0..REPORT_WORDS), bits));
    }

    /// Somebody else changes what the axes have, on a control that lets them; they are known to have been prompt.
    fn others_write(&mut self) {
        if self.kind != Kind::Lossy {
            return;
        }
        let mut values = PerChannel::ZERO;
        if self.random.random() {
            for i in self.axes() {
                let steps = f64::from(self.random.random_range(-40..40));
                values[i] = steps * self.limits.axes[i].resolution;
            }
        }
        self.seen.changed = true;
        self.prompt_until = self.now + Duration::from_secs(2);
        self.put(values);
        self.may_be_beyond();
    }

    /// What stands now may lie beyond a limit.
    fn may_be_beyond(&mut self) {
        for i in self.axes() {
            let axis = &self.limits.axes[i];
            let reach = (axis.slew_per_s * PERIOD.as_secs_f64()).max(axis.resolution);
            self.beyond[i] = self.applied[i].abs() + reach;
        }
    }

    /// Limits, slews and accelerations change in the middle of whatever goes on.
    fn change_limits(&mut self) {
        let full = full_limits(self.limits.count);
        for i in self.axes() {
            let mut part = |least: f64| {
                if self.random.random() {
                    1.0
                } else {
                    self.random.random_range(least..1.0)
                }
            };
            let axis = &mut self.limits.axes[i];
            axis.limit = (full.axes[i].limit * part(0.05)).max(6.0 * axis.resolution);
            axis.warn = 0.5 * axis.limit;
            axis.slew_per_s = full.axes[i].slew_per_s * part(0.02);
            axis.accel_per_s2 = [f64::INFINITY, full.axes[i].accel_per_s2 * part(0.01)]
                [usize::from(self.random.random::<bool>())];
        }
        self.may_be_beyond();
        self.seen.began = true;
        let ramp_ms = self.random.random_range(0..500);
        self.limits.ramp = Duration::from_millis(ramp_ms);
        self.guard.set_limits(self.limits).expect("good limits");
    }

    /// The control starts anew. Its words are kept.
    fn power_up(&mut self) {
        if let Some(before) = self.barrier {
            let epoch = before.memory().link.epoch;
            let tick = self.random.random();
            let full = full_limits(self.limits.count);
            self.barrier = Some(barrier(&full, tick, epoch, &self.applied));
        }
    }

    /// The gateway starts anew, under another number.
    fn restart(&mut self) {
        let has_no_read_back = matches!(self.kind, Kind::Lines | Kind::LinesWithTimeOut);
        if has_no_read_back && self.ways.len() > 1 {
            return;
        }
        let age = self.now.saturating_sub(self.got);
        let owner = self.random.random_range(1..60_000);
        self.seen.began = true;
        self.guard = Guard::new(self.limits).expect("good limits");
        self.selector = Selector::new(Duration::from_millis(500));
        self.interlocks = Interlocks::default();
        for index in 0..self.ways.len() {
            let mut way = Way::new(self.read_back(owner));
            way.late = self.ways[index].late;
            way.online = self.ways[index].online;
            self.ways[index] = way;
        }
        if has_no_read_back {
            let values = self.written;
            self.ways[0]
                .read_back
                .restore(self.now, &values, age, &self.limits);
        }
    }
}
