use volcomp_document::{InputError, Section, Value};
use volcomp_fit::{Choice, Fit, FitError, FitOptions, Method, choose_and_fit, choose_mls};
use volcomp_vocabulary::{AxisKind, AxisName};

/// Maximum order of a polynomial or series, or number of harmonics, in a file.
const HIGHEST_ORDER: usize = 40;

/// Kind of curve that is fitted to a measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum CurveChoice {
    /// The kind that [`choose`](volcomp_fit::choose) selects for both directions of the error together.
    #[default]
    Auto,
    /// A polynomial by least squares.
    Polynomial {
        /// The highest power of the coordinate.
        order: usize,
    },
    /// A Chebyshev series by least squares.
    Chebyshev {
        /// The order of its last term.
        order: usize,
    },
    /// Moving least squares: at each coordinate, a polynomial fitted to the readings near it.
    MovingLeastSquares {
        /// Order of the local polynomials.
        order: usize,
        /// Half width of the weight as a fraction of the range.
        support: f64,
        /// Steepness of the decay of the weight, α of the Gaussian.
        shape: f64,
    },
    /// Moving least squares whose order and support are chosen from the readings of both directions by the leave-one-out
    /// error ([`choose_mls`]).
    AutoMovingLeastSquares {
        /// Steepness of the decay of the weight, α of the Gaussian.
        shape: f64,
    },
    /// A cubic smoothing B-spline, smoothed by generalised cross-validation.
    BSpline,
    /// A table of the mean readings, with linear interpolation.
    LinearTable,
    /// A table of the mean readings, with monotone cubic interpolation.
    CubicTable,
    /// A Fourier series, for rotary axes.
    Fourier {
        /// The number of harmonics.
        order: usize,
        /// The period of the first harmonic, deg.
        period: f64,
    },
}

/// Choice of a method, with the fits made for the choice.
type Chosen = (Choice, Vec<Fit>);

impl CurveChoice {
    /// Decodes the key `curve` of a `[[measurement]]`, for an error of `axis`.
    ///
    /// # Errors
    /// An unknown kind, or an option that is invalid for it.
    pub fn decode(value: &Value<'_>, axis: AxisName) -> Result<Self, InputError> {
        if let Ok(word) = value.text() {
            return match word {
                "auto" => Ok(Self::Auto),
                _ => Err(value.error(format!(
                    "found \"{word}\", expected \"auto\" or one kind of curve: {{ poly = {{ order = 6 }} }}"
                ))),
            };
        }
        let table = value.section()?;
        table.allow(&["poly", "chebyshev", "mls", "bspline", "table", "fourier"])?;
        let kinds: Vec<_> = table.values().collect();
        let [(kind, options)] = &kinds[..] else {
            return Err(value.error(format!("found {} kinds of curve, expected one", kinds.len())));
        };
        if *kind == "fourier" && axis.kind() == AxisKind::Linear {
            return Err(
                value.error(format!("found fourier for axis {axis}, expected it on a rotary axis"))
            );
        }
        if options.is_number() && ["poly", "chebyshev", "mls", "fourier"].contains(kind) {
            let order = options.number()?;
            return Err(options.error(format!(
                "found {order}, expected the order with its name: {{ {kind} = {{ order = {order} }} }}"
            )));
        }
        Self::decode_options(kind, &options.section()?)
    }

    fn decode_options(kind: &str, options: &Section<'_>) -> Result<Self, InputError> {
        let order = |default| options.get("order").map_or(Ok(default), |v| v.count(HIGHEST_ORDER));
        let number = |key: &str, default| options.get(key).map_or(Ok(default), |v| v.number());
        Ok(match kind {
            "poly" | "chebyshev" => {
                options.allow(&["order"])?;
                let order = order(6)?;
                if kind == "poly" { Self::Polynomial { order } } else { Self::Chebyshev { order } }
            }
            "mls" => {
                options.allow(&["auto", "order", "support", "shape"])?;
                if options.truth_or("auto", false)? {
                    let mut stated = ["order", "support"].into_iter();
                    if let Some(value) = stated.find_map(|key| options.get(key)) {
                        return Err(value.error(
                            "found a setting beside `auto = true`, which chooses order and support: expected one of them",
                        ));
                    }
                    return Ok(Self::AutoMovingLeastSquares { shape: number("shape", 3.0)? });
                }
                Self::MovingLeastSquares {
                    order: order(4)?,
                    support: number("support", 1.0 / 3.0)?,
                    shape: number("shape", 3.0)?,
                }
            }
            "bspline" => {
                options.allow(&[])?;
                Self::BSpline
            }
            "fourier" => {
                options.allow(&["order", "period"])?;
                Self::Fourier { order: order(4)?, period: number("period", 360.0)? }
            }
            _ => {
                options.allow(&["interpolation"])?;
                let words = [("linear", Self::LinearTable), ("cubic", Self::CubicTable)];
                options.one_of("interpolation", &words, Self::LinearTable)?
            }
        })
    }

    /// Formats the value of the key `curve` that decodes to this choice.
    pub fn to_toml(self) -> String {
        match self {
            Self::Auto => "\"auto\"".to_owned(),
            Self::Polynomial { order } => format!("{{ poly = {{ order = {order} }} }}"),
            Self::Chebyshev { order } => format!("{{ chebyshev = {{ order = {order} }} }}"),
            Self::MovingLeastSquares { order, support, shape } => format!(
                "{{ mls = {{ order = {order}, support = {support:?}, shape = {shape:?} }} }}"
            ),
            Self::AutoMovingLeastSquares { shape } => {
                format!("{{ mls = {{ auto = true, shape = {shape:?} }} }}")
            }
            Self::BSpline => "{ bspline = {} }".to_owned(),
            Self::LinearTable => "{ table = { interpolation = \"linear\" } }".to_owned(),
            Self::CubicTable => "{ table = { interpolation = \"cubic\" } }".to_owned(),
            Self::Fourier { order, period } => {
                format!("{{ fourier = {{ order = {order}, period = {period:?} }} }}")
            }
        }
    }

    /// The method for all directions of an error and, if it was chosen from the readings, the choice with its fits. Automatic moving least squares
    /// prefer settings with residuals of at most `required`.
    pub(crate) fn settled(
        self,
        directions: &[(&[f64], &[f64])],
        required: Option<f64>,
        options: &FitOptions,
    ) -> Result<(Method, Option<Chosen>), FitError> {
        let stated = match self {
            Self::Auto => {
                let (choice, fits) = choose_and_fit(directions, options)?;
                return Ok((choice.method, Some((choice, fits))));
            }
            Self::AutoMovingLeastSquares { shape } => {
                let (order, support) = choose_mls(directions, shape, required)?;
                Method::MovingLeastSquares { order, support, shape }
            }
            Self::Polynomial { order } => Method::Polynomial { order },
            Self::Chebyshev { order } => Method::Chebyshev { order },
            Self::MovingLeastSquares { order, support, shape } => {
                Method::MovingLeastSquares { order, support, shape }
            }
            Self::BSpline => Method::BSpline,
            Self::LinearTable => Method::LinearTable,
            Self::CubicTable => Method::CubicTable,
            Self::Fourier { order, period } => Method::Fourier { order, period },
        };
        Ok((stated, None))
    }
}
