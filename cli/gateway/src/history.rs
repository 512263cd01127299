//! The history of a month: one point a minute, in memory and in two files of the audit folder.
//!
//! A thread owns the files. The service passes each complete minute to the thread and never waits. A line of a file is
//! a JSON list: the names of the columns (at each start), or the time, the state and the values of one minute.

use std::{
    collections::VecDeque,
    fs::{self, File, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex,
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread,
    time::Duration,
};

use volcomp_vocabulary::{AxisKind, AxisName};

use crate::{
    documents::{HistoryPoint, StateName, Status, round},
    interop::quantities::length,
    locked,
};

/// Maximum length of the history, s.
pub(crate) const MAX_SPAN_S: u32 = 30 * 86_400;
const MINUTE_S: i64 = 60;
/// Number of minutes in [`MAX_SPAN_S`]. A file with this many lines is closed, and the next one is started.
const MAX_POINTS: usize = 30 * 24 * 60;
/// Before this program existed, s since 1970: the clock was not set yet.
const NOT_SET_S: i64 = 1_700_000_000;
/// Maximum number of points in a response. A span that starts inside a point has one more.
const MAX_BUCKETS: u32 = 600;
/// Larger files are ignored. 64 sensors and 9 axes need less than 1 kB for each point, so a larger file is no history.
const MAX_FILE_BYTES: u64 = 64 << 20;
/// Maximum number of minutes queued while the disk hangs; further ones are dropped.
const MAX_QUEUED: usize = 64;
const CURRENT: &str = "history.jsonl";
const OLD: &str = "history.1.jsonl";

/// How values of a column are combined over time.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Rule {
    Mean,
    Min,
    Max,
}

/// Columns of the errors: position in µm, direction of the tool axis in µrad.
const ERRORS: [(&str, Rule); 8] = [
    ("error_um", Rule::Mean),
    ("error_max_um", Rule::Max),
    ("residual_um", Rule::Mean),
    ("residual_max_um", Rule::Max),
    ("error_axis_urad", Rule::Mean),
    ("error_axis_max_urad", Rule::Max),
    ("residual_axis_urad", Rule::Mean),
    ("residual_axis_max_urad", Rule::Max),
];
/// Columns of the correction of one axis, µm or µrad.
const CORRECTION: [(&str, Rule); 3] =
    [("correction", Rule::Mean), ("correction_min", Rule::Min), ("correction_max", Rule::Max)];

/// Rounds to single precision: seven digits, enough for the displayed values.
#[expect(clippy::cast_possible_truncation, reason = "the digits beyond are dropped")]
fn single(value: f64) -> f32 {
    value as f32
}

/// Whole seconds since 1970, rounded down; 0 for times before 1970.
fn whole(s: f64) -> i64 {
    let since = Duration::try_from_secs_f64(s).unwrap_or_default();
    i64::try_from(since.as_secs()).unwrap_or_default()
}

/// The quantities of a point, in the order of its values: errors, then corrections of each axis, then temperatures.
#[derive(Debug)]
pub(crate) struct Columns {
    axes: Vec<AxisName>,
    sensors: Vec<String>,
}

impl Columns {
    pub(crate) fn new(axes: &[AxisName], sensors: &[String]) -> Self {
        let mut axes = axes.to_vec();
        axes.sort_unstable();
        Self { axes, sensors: sensors.to_vec() }
    }

    fn rules(&self) -> impl Iterator<Item = Rule> {
        let corrections = self.axes.iter().flat_map(|_| CORRECTION);
        let all = ERRORS.into_iter().chain(corrections).map(|(_, rule)| rule);
        all.chain(self.sensors.iter().map(|_| Rule::Mean))
    }

    fn names(&self) -> Vec<String> {
        let errors = ERRORS.iter().map(|(name, _)| (*name).to_owned());
        let corrections = self.axes.iter().flat_map(|axis| {
            let name = move |(name, _)| format!("{name} {axis}");
            CORRECTION.into_iter().map(name)
        });
        let sensors = self.sensors.iter().map(|name| format!("degc {name}"));
        errors.chain(corrections).chain(sensors).collect()
    }

    /// The values of a single state; NaN: unknown.
    fn values(&self, point: &HistoryPoint) -> Vec<f32> {
        let value = |value: Option<f64>| value.map_or(f32::NAN, single);
        let errors =
            [point.error_um, point.residual_um, point.error_axis_urad, point.residual_axis_urad];
        let errors = errors.into_iter().flat_map(|error| [error; 2]);
        let corrections = self.axes.iter().flat_map(|axis| {
            let [linear, rotary] = [&point.correction_um, &point.correction_urad];
            [linear.get(axis).or(rotary.get(axis)).copied(); 3]
        });
        let sensors = self.sensors.iter();
        let sensors = sensors.map(|name| point.temperatures_degc.get(name).copied());
        errors.chain(corrections).chain(sensors).map(value).collect()
    }

    /// Converts a minute to a point of a response; `at_s` is its time since the start of the control thread, s.
    fn point(&self, minute: &Minute, at_s: f64) -> HistoryPoint {
        let known = |index: usize| {
            let value = minute.values.get(index).copied().map(f64::from);
            value.filter(|value| value.is_finite()).map(round)
        };
        let mut point = HistoryPoint {
            at_s: round(at_s),
            state: Some(minute.state),
            error_um: known(0),
            error_max_um: known(1),
            residual_um: known(2),
            residual_max_um: known(3),
            error_axis_urad: known(4),
            error_axis_max_urad: known(5),
            residual_axis_urad: known(6),
            residual_axis_max_urad: known(7),
            ..HistoryPoint::default()
        };
        for (place, axis) in self.axes.iter().enumerate() {
            let first = ERRORS.len() + place * CORRECTION.len();
            let (means, ranges) = match axis.kind() {
                AxisKind::Linear => (&mut point.correction_um, &mut point.correction_range_um),
                AxisKind::Rotary => (&mut point.correction_urad, &mut point.correction_range_urad),
            };
            if let (Some(mean), Some(min), Some(max)) =
                (known(first), known(first + 1), known(first + 2))
            {
                means.insert(*axis, mean);
                ranges.insert(*axis, [min, max]);
            }
        }
        let first = ERRORS.len() + self.axes.len() * CORRECTION.len();
        for (place, name) in self.sensors.iter().enumerate() {
            if let Some(degc) = known(first + place) {
                point.temperatures_degc.insert(name.clone(), degc);
            }
        }
        point
    }
}

/// Converts a state to a point.
pub(crate) fn point_of(status: &Status) -> HistoryPoint {
    let length = |v: Option<[f64; 3]>| v.map(|v| round(length(v)));
    let mut point = HistoryPoint {
        at_s: status.uptime_s,
        error_um: length(status.true_error_um.or(status.error_um)),
        residual_um: length(status.true_residual_um.or(status.residual_um)),
        error_axis_urad: length(status.error_axis_urad),
        residual_axis_urad: length(status.residual_axis_urad),
        state: Some(status.state),
        ..HistoryPoint::default()
    };
    if status.correction_known {
        point.correction_um.clone_from(&status.correction_um);
        point.correction_urad.clone_from(&status.correction_urad);
    }
    let sensors = status.temperatures.iter();
    let known = sensors.filter_map(|sensor| Some((sensor.name.clone(), sensor.degc?)));
    point.temperatures_degc = known.collect();
    point
}

/// Removes the residual from a point without applied correction, where the residual equals the error.
pub(crate) fn without_idle_residual(mut point: HistoryPoint) -> HistoryPoint {
    let mut corrections = (point.correction_um.values()).chain(point.correction_urad.values());
    if corrections.all(|correction| *correction == 0.0) {
        (point.residual_um, point.residual_axis_urad) = (None, None);
    }
    point
}

/// The combined values of one minute or of several.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Minute {
    /// Start, s since 1970.
    at_s: i64,
    state: StateName,
    /// Values in the order of [`Columns`]; NaN: unknown.
    values: Box<[f32]>,
}

/// Combines values of the same columns.
#[derive(Clone, Debug)]
struct Bucket {
    rules: Vec<Rule>,
    values: Vec<f64>,
    counts: Vec<u32>,
    states: [u32; StateName::ALL.len()],
}

impl Bucket {
    fn new(columns: &Columns) -> Self {
        let rules: Vec<Rule> = columns.rules().collect();
        Self {
            values: vec![0.0; rules.len()],
            counts: vec![0; rules.len()],
            states: [0; StateName::ALL.len()],
            rules,
        }
    }

    fn add(&mut self, state: StateName, values: &[f32]) {
        for (place, value) in values.iter().enumerate().take(self.rules.len()) {
            let value = f64::from(*value);
            if !value.is_finite() {
                continue;
            }
            let so_far = &mut self.values[place];
            let is_first = self.counts[place] == 0;
            match self.rules[place] {
                Rule::Mean => *so_far += value,
                Rule::Min if is_first || value < *so_far => *so_far = value,
                Rule::Max if is_first || value > *so_far => *so_far = value,
                Rule::Min | Rule::Max => {}
            }
            self.counts[place] += 1;
        }
        if let Some(place) = StateName::ALL.iter().position(|one| *one == state) {
            self.states[place] += 1;
        }
    }

    fn minute(&self, at_s: i64) -> Minute {
        let value = |place: usize| match (self.counts[place], self.rules[place]) {
            (0, _) => f32::NAN,
            (count, Rule::Mean) => single(self.values[place] / f64::from(count)),
            (_, Rule::Min | Rule::Max) => single(self.values[place]),
        };
        Minute { at_s, state: self.state(), values: (0..self.rules.len()).map(value).collect() }
    }

    /// The most frequent state. However short, `Faulted` and `Unknown` take precedence, so that a long span still shows
    /// them.
    fn state(&self) -> StateName {
        let states = StateName::ALL.into_iter().zip(self.states);
        let weight = |(state, count): &(StateName, u32)| {
            let matters = matches!(state, StateName::Faulted | StateName::Unknown);
            (matters && *count > 0, *count)
        };
        let most = states.max_by_key(weight);
        most.map_or(StateName::Unknown, |(state, _)| state)
    }
}

/// The complete minutes of 30 days, oldest first; their times increase.
#[derive(Debug, Default)]
pub(crate) struct Minutes(VecDeque<Minute>);

impl Minutes {
    /// Inserts a minute in the order of time; it replaces a known one of the same time. Beyond [`MAX_POINTS`] the first or the last minute is
    /// dropped: a first one before [`NOT_SET_S`], otherwise whichever is further from the inserted one, so that a wrong clock or a damaged line costs
    /// no more than its own minutes.
    fn push(&mut self, minute: Minute) {
        let at_s = minute.at_s;
        let place = self.0.partition_point(|known| known.at_s < at_s);
        match self.0.get_mut(place).filter(|known| known.at_s == at_s) {
            Some(known) => *known = minute,
            None => self.0.insert(place, minute),
        }
        if self.0.len() > MAX_POINTS {
            let distance = |end: Option<&Minute>| end.map(|end| end.at_s.abs_diff(at_s));
            let is_set = self.0.front().is_some_and(|first| first.at_s >= NOT_SET_S);
            if !is_set || distance(self.0.front()) >= distance(self.0.back()) {
                self.0.pop_front();
            } else {
                self.0.pop_back();
            }
        }
    }
}

/// Collects the states of the current minute, and passes complete minutes to the thread that writes the files.
pub(crate) struct Recorder {
    columns: Arc<Columns>,
    minutes: Arc<Mutex<Minutes>>,
    current: Option<(i64, Bucket)>,
    files: SyncSender<Minute>,
}

impl Recorder {
    /// Starts the thread, which first reads the files of a folder.
    ///
    /// # Errors
    /// The operating system cannot create a thread.
    pub(crate) fn start(dir: &Path, columns: Columns) -> io::Result<Self> {
        let (files, work) = sync_channel(MAX_QUEUED);
        let columns = Arc::new(columns);
        let minutes = Arc::new(Mutex::new(Minutes::default()));
        let thread = FilesThread {
            dir: dir.to_owned(),
            columns: Arc::clone(&columns),
            minutes: Arc::clone(&minutes),
        };
        // The thread logs under the span of the machine that starts it.
        let span = tracing::Span::current();
        thread::Builder::new()
            .name("volcomp-history".to_owned())
            .spawn(move || span.in_scope(|| thread.run(&work)))?;
        Ok(Self { columns, minutes, current: None, files })
    }

    /// Adds a state at the time `now_s`, s since 1970.
    pub(crate) fn add(&mut self, now_s: f64, point: &HistoryPoint) {
        let at_s = whole(now_s).div_euclid(MINUTE_S) * MINUTE_S;
        if let Some((begun_s, bucket)) = &self.current
            && *begun_s != at_s
        {
            // The minute is dropped if the queue is full: a disk that hangs shortens the history and delays nothing.
            let _ = self.files.try_send(bucket.minute(*begun_s));
            self.current = None;
        }
        let new = || (at_s, Bucket::new(&self.columns));
        let (_, bucket) = self.current.get_or_insert_with(new);
        let state = point.state.unwrap_or(StateName::Unknown);
        bucket.add(state, &self.columns.values(point));
    }

    /// The columns, the stored minutes and the current minute: the arguments of [`over`]. The caller can release the
    /// recorder before it combines the minutes.
    pub(crate) fn parts(&self) -> (Arc<Columns>, Arc<Mutex<Minutes>>, Option<Minute>) {
        let current = self.current.as_ref();
        let current = current.map(|(at_s, bucket)| bucket.minute(*at_s));
        (Arc::clone(&self.columns), Arc::clone(&self.minutes), current)
    }
}

/// The points of the last `span_s` seconds, one for each step, and the step, s. There are at most [`MAX_BUCKETS`]
/// points, or one more if the span starts inside a point. `now_s` and `start_s`, the start of the control thread, are s
/// since 1970.
pub(crate) fn over(
    columns: &Columns,
    minutes: &Mutex<Minutes>,
    current: Option<&Minute>,
    span_s: u32,
    [now_s, start_s]: [f64; 2],
) -> (i64, Vec<HistoryPoint>) {
    let step = i64::from(span_s.div_ceil(MAX_BUCKETS).next_multiple_of(60));
    let from = whole(now_s) - i64::from(span_s);
    let mut points = Vec::new();
    let mut bucket: Option<(i64, Bucket)> = None;
    let mut end = |bucket: &Option<(i64, Bucket)>| {
        if let Some((at_s, bucket)) = bucket {
            points.push(columns.point(&bucket.minute(*at_s), *at_s as f64 - start_s));
        }
    };
    let minutes = locked(minutes);
    let shown = minutes.0.iter().chain(current);
    // Buckets begin at multiples of their length, so that a point keeps its value as time passes.
    let shown = shown.filter(|minute| minute.at_s > from - step && minute.at_s as f64 <= now_s);
    for minute in shown {
        let at_s = minute.at_s.div_euclid(step) * step;
        if bucket.as_ref().is_none_or(|(begun_s, _)| *begun_s != at_s) {
            end(&bucket);
            bucket = Some((at_s, Bucket::new(columns)));
        }
        if let Some((_, bucket)) = &mut bucket {
            bucket.add(minute.state, &minute.values);
        }
    }
    end(&bucket);
    (step, points)
}

type Row = (i64, StateName, Vec<Option<f32>>);
type Head = (String, String, Vec<String>);

/// The thread that reads and appends the files.
struct FilesThread {
    dir: PathBuf,
    columns: Arc<Columns>,
    minutes: Arc<Mutex<Minutes>>,
}

/// Number of lines of a file, number of damaged lines, and whether the last line is incomplete.
#[derive(Debug, Default, PartialEq)]
struct FileState {
    rows: usize,
    damaged: usize,
    ends_torn: bool,
}

impl FilesThread {
    fn run(self, work: &Receiver<Minute>) {
        let mut read = Minutes::default();
        let _ = self.read(OLD, &mut read);
        let found = self.read(CURRENT, &mut read);
        tracing::info!("history: {} minutes read", read.0.len());
        *locked(&self.minutes) = read;
        let mut file: Option<File> = None;
        let mut rows = found.rows;
        let mut fails = false;
        let mut torn = found.ends_torn;
        while let Ok(minute) = work.recv() {
            let written = self.append(&mut file, &mut rows, torn, &minute);
            locked(&self.minutes).push(minute);
            torn = written.is_err();
            if let Err(e) = &written {
                file = None;
                if !fails {
                    tracing::warn!("{}: {e}: it is shorter", self.dir.join(CURRENT).display());
                }
            }
            fails = written.is_err();
        }
    }

    /// Adds the minutes of a file. A missing or damaged file shortens the history.
    fn read(&self, name: &str, into: &mut Minutes) -> FileState {
        let path = self.dir.join(name);
        let bytes = match fs::metadata(&path) {
            Ok(found) if found.len() > MAX_FILE_BYTES => {
                tracing::warn!("{}: not a history, ignored: too large", path.display());
                return FileState { rows: MAX_POINTS, ..FileState::default() };
            }
            Ok(_) => fs::read(&path),
            Err(e) => Err(e),
        };
        let bytes = match bytes {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == io::ErrorKind::NotFound => return FileState::default(),
            Err(e) => {
                tracing::warn!("{}: {e}: the history is shorter", path.display());
                return FileState::default();
            }
        };
        let found = self.parse(&bytes, into);
        if found.damaged > 0 {
            let count = found.damaged;
            tracing::warn!("{}: {count} damaged lines were skipped", path.display());
        }
        found
    }

    fn parse(&self, bytes: &[u8], into: &mut Minutes) -> FileState {
        let names = self.columns.names();
        // For each column of the file, its index among the present columns; `None`: the column no longer exists.
        let mut places: Vec<Option<usize>> = Vec::new();
        let mut found = FileState {
            ends_torn: bytes.last().is_some_and(|last| *last != b'\n'),
            ..FileState::default()
        };
        let lines = bytes.split(|byte| *byte == b'\n');
        for line in lines.filter(|line| !line.is_empty()) {
            found.rows += 1;
            if let Ok((_, _, columns)) = serde_json::from_slice::<Head>(line) {
                let place = |column: &String| names.iter().position(|name| name == column);
                places = columns.iter().map(place).collect();
                continue;
            }
            match serde_json::from_slice::<Row>(line) {
                Ok((at_s, state, row)) if row.len() == places.len() && at_s % MINUTE_S == 0 => {
                    let mut values = vec![f32::NAN; names.len()];
                    for (place, value) in places.iter().zip(row) {
                        if let (Some(place), Some(value)) = (*place, value) {
                            values[place] = value;
                        }
                    }
                    into.push(Minute { at_s, state, values: values.into() });
                }
                _ => found.damaged += 1,
            }
        }
        found
    }

    fn append(
        &self,
        file: &mut Option<File>,
        rows: &mut usize,
        torn: bool,
        minute: &Minute,
    ) -> io::Result<()> {
        let path = self.dir.join(CURRENT);
        if *rows >= MAX_POINTS {
            *file = None;
            fs::rename(&path, self.dir.join(OLD))?;
            *rows = 0;
        }
        let mut text = String::new();
        if file.is_none() {
            *file = Some(OpenOptions::new().append(true).create(true).open(&path)?);
            if torn {
                text.push('\n');
            }
            let names: Head = ("s".to_owned(), "state".to_owned(), self.columns.names());
            text.push_str(&serde_json::to_string(&names)?);
            text.push('\n');
            *rows += 1;
        }
        let short = |value: &f32| value.is_finite().then(|| (value * 100.0).round() / 100.0);
        let values = minute.values.iter().map(short).collect();
        let row: Row = (minute.at_s, minute.state, values);
        text.push_str(&serde_json::to_string(&row)?);
        text.push('\n');
        if let Some(file) = file {
            file.write_all(text.as_bytes())?;
        }
        *rows += 1;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    /// 2026-11-30 13:00.
    const NOON_S: i64 = 1_796_043_600;

    fn columns() -> Columns {
        Columns::new(&[AxisName::X, AxisName::C], &["bed".to_owned()])
    }

    /// A state of a minute whose error is `value`.
    fn point(value: f64) -> HistoryPoint {
        HistoryPoint {
            error_um: Some(value),
            residual_um: Some(value / 10.0),
            state: Some(StateName::Compensating),
            correction_um: [(AxisName::X, -value)].into(),
            correction_urad: [(AxisName::C, 2.0 * value)].into(),
            temperatures_degc: [("bed".to_owned(), 20.0 + value)].into(),
            ..HistoryPoint::default()
        }
    }

    fn wait_for(minutes: &Mutex<Minutes>, count: usize) {
        let end = Instant::now() + Duration::from_secs(20);
        while locked(minutes).0.len() < count {
            assert!(Instant::now() < end, "{} minutes", locked(minutes).0.len());
            thread::sleep(Duration::from_millis(2));
        }
    }

    /// Records `minutes` minutes, each with two states, and returns once they are in the ring.
    fn record(dir: &Path, from_s: i64, minutes: i64, before: usize) -> Recorder {
        let mut recorder = Recorder::start(dir, columns()).expect("a thread");
        wait_for(&recorder.minutes, before);
        for minute in 0..minutes {
            let at_s = (from_s + 60 * minute) as f64;
            recorder.add(at_s + 1.0, &point(minute as f64));
            recorder.add(at_s + 30.0, &point(minute as f64 + 2.0));
            if minute % 32 == 0 {
                wait_for(&recorder.minutes, before + usize::try_from(minute).expect("few"));
            }
        }
        let complete = before + usize::try_from(minutes).expect("few") - 1;
        wait_for(&recorder.minutes, complete);
        recorder
    }

    fn answer(recorder: &Recorder, span_s: u32, now_s: i64) -> (i64, Vec<HistoryPoint>) {
        let (columns, minutes, current) = recorder.parts();
        let times = [now_s as f64, NOON_S as f64];
        over(&columns, &minutes, current.as_ref(), span_s, times)
    }

    #[test]
    fn minutes_and_buckets_are_plain_means_and_extremes() {
        let dir = tempfile::tempdir().expect("writable");
        let recorder = record(dir.path(), NOON_S, 6, 0);
        let (step, points) = answer(&recorder, 600, NOON_S + 359);
        assert_eq!((step, points.len()), (60, 6));
        // The last minute is not complete.
        for (minute, point) in points.iter().enumerate() {
            let minute = minute as f64;
            assert_eq!(point.at_s, 60.0 * minute);
            assert_eq!(point.error_um, Some(minute + 1.0));
            assert_eq!(point.error_max_um, Some(minute + 2.0));
            assert_eq!(point.residual_max_um, Some((minute + 2.0) / 10.0));
            assert_eq!(point.correction_um[&AxisName::X], -(minute + 1.0));
            let range = point.correction_range_um[&AxisName::X];
            assert_eq!(range, [-(minute + 2.0), -minute]);
            assert_eq!(point.correction_urad[&AxisName::C], 2.0 * (minute + 1.0));
            assert_eq!(point.temperatures_degc["bed"], 21.0 + minute);
            assert_eq!(point.state, Some(StateName::Compensating));
            assert_eq!(point.error_axis_urad, None);
        }
        // A day has buckets of three minutes: 0 to 2, and 3 to 5.
        let (step, points) = answer(&recorder, 86_400, NOON_S + 359);
        assert_eq!(step, 180);
        let found: Vec<_> = points.iter().map(|p| (p.at_s, p.error_um)).collect();
        assert_eq!(found, [(0.0, Some(2.0)), (180.0, Some(5.0))]);
        let range = points[1].correction_range_um[&AxisName::X];
        assert_eq!((points[1].error_max_um, range), (Some(7.0), [-7.0, -3.0]));
    }

    #[test]
    fn a_fault_of_a_moment_is_seen_in_a_bucket_and_unknown_values_count_for_nothing() {
        let mut bucket = Bucket::new(&columns());
        let unknown = columns().values(&HistoryPoint::default());
        for _ in 0..9 {
            bucket.add(StateName::Compensating, &unknown);
        }
        assert_eq!(bucket.minute(0).state, StateName::Compensating);
        assert!(bucket.minute(0).values.iter().all(|value| value.is_nan()));
        bucket.add(StateName::Faulted, &columns().values(&point(3.0)));
        assert_eq!(bucket.minute(0).state, StateName::Faulted);
        assert_eq!(bucket.minute(0).values[0], 3.0);
    }

    #[test]
    fn nothing_applied_has_no_residual() {
        let idle = HistoryPoint {
            correction_um: [(AxisName::X, 0.0)].into(),
            correction_urad: [(AxisName::C, 0.0)].into(),
            ..point(3.0)
        };
        assert_eq!(without_idle_residual(idle).residual_um, None);
        assert_eq!(without_idle_residual(point(3.0)).residual_um, Some(0.3));
    }

    #[test]
    fn it_survives_a_restart_other_sensors_and_damage() {
        let dir = tempfile::tempdir().expect("writable");
        drop(record(dir.path(), NOON_S, 6, 0));
        let file = dir.path().join(CURRENT);
        // The end of a line is missing, as after a power failure.
        let text = fs::read_to_string(&file).expect("written");
        assert_eq!(text.lines().count(), 6, "{text}");
        fs::write(&file, &text[..text.len() - 9]).expect("writable");
        let recorder = record(dir.path(), NOON_S + 600, 3, 4);
        assert_eq!(locked(&recorder.minutes).0.len(), 6);
        drop(recorder);
        // Garbage in the middle of a file costs only its own lines.
        let text = fs::read_to_string(&file).expect("written");
        let line = text.lines().nth(2).expect("a line").to_owned();
        fs::write(&file, text.replacen(&line, "[1,\u{0}", 1)).expect("writable");
        let thread = FilesThread {
            dir: dir.path().to_owned(),
            columns: Arc::new(Columns::new(&[AxisName::X], &["new".to_owned(), "bed".to_owned()])),
            minutes: Arc::default(),
        };
        let mut minutes = Minutes::default();
        let found = thread.read(CURRENT, &mut minutes);
        assert_eq!((found.damaged, found.ends_torn), (2, false));
        let times: Vec<_> = minutes.0.iter().map(|one| (one.at_s - NOON_S) / 60).collect();
        assert_eq!(times, [0, 2, 3, 10, 11]);
        let last = thread.columns.point(&minutes.0[4], 0.0);
        assert_eq!(last.temperatures_degc, [("bed".to_owned(), 22.0)].into());
        assert!(last.correction_urad.is_empty());
        let missing = thread.read("none", &mut minutes);
        assert_eq!(missing, FileState::default());
    }

    /// The clock of a computer whose battery is empty is wrong until its first synchronisation; a damaged digit looks the same.
    #[test]
    fn a_wrong_clock_costs_only_its_own_minutes() {
        let minute = |at_s| Minute { at_s, state: StateName::Compensating, values: Box::default() };
        let mut minutes = Minutes::default();
        let month = i64::try_from(MAX_POINTS).expect("few");
        let wrong = [0, NOON_S - 86_400, NOON_S + 60, 9_796_043_600, i64::MIN, i64::MAX];
        for number in 0..month {
            minutes.push(minute(NOON_S + 60 * number));
        }
        for at_s in [0, 60, 120] {
            let kept = minutes.0.clone();
            minutes.push(minute(at_s));
            assert!(minutes.0 == kept, "another minute than that of {at_s} s was dropped");
        }
        for (count, wrong) in wrong.into_iter().enumerate() {
            minutes.push(minute(wrong / 60 * 60));
            minutes.push(minute(NOON_S + 60 * (month + i64::try_from(count).expect("few"))));
        }
        let times: Vec<i64> = minutes.0.iter().map(|one| one.at_s).collect();
        assert_eq!(times.len(), MAX_POINTS);
        assert!(times.is_sorted_by(|one, next| one < next));
        let right = times.iter().filter(|s| (NOON_S..NOON_S + 2 * 60 * month).contains(s));
        assert!(right.count() >= MAX_POINTS - 2 * wrong.len());
    }

    #[test]
    fn memory_and_files_are_bounded() {
        let minute = |at_s| Minute { at_s, state: StateName::Compensating, values: Box::default() };
        let mut minutes = Minutes::default();
        for number in 0..i64::try_from(MAX_POINTS).expect("few") + 500 {
            minutes.push(minute(60 * number));
        }
        assert_eq!(minutes.0.len(), MAX_POINTS);
        let dir = tempfile::tempdir().expect("writable");
        let thread = FilesThread {
            dir: dir.path().to_owned(),
            columns: Arc::new(columns()),
            minutes: Arc::default(),
        };
        let (mut file, mut rows) = (None, MAX_POINTS - 2);
        for number in 0..6 {
            let minute = Minute { values: vec![f32::NAN; 15].into(), ..minute(60 * number) };
            let written = thread.append(&mut file, &mut rows, false, &minute);
            written.expect("writable");
        }
        let lines = |name| fs::read_to_string(dir.path().join(name)).expect("a file");
        assert_eq!((lines(OLD).lines().count(), lines(CURRENT).lines().count()), (2, 6));
        assert_eq!(rows, 6);
        let count = fs::read_dir(dir.path()).expect("a folder").count();
        assert_eq!(count, 2);
    }
}
