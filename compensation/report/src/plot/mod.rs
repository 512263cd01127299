//! Plots as SVG: pure functions from data to text. Each returns one `<svg>` element, whose colours come from [`STYLE`], so that a page can
//! be light or dark.
//!
//! Values that are not finite are not drawn. Texts are escaped.

mod bars;
mod colour;
mod heat_map;
mod marks;
mod path;
mod picture;
mod polar;
mod quiver;
mod scale;
mod square_sketch;
mod svg;
mod thin;
mod xy;

pub use bars::{Bars, bars};
pub use colour::{colour_at, colour_bar, colour_scale, colour_variables};
pub use heat_map::{HeatMap, heat_map};
pub use marks::Mark;
pub use path::{PathPlot, PathPoint, path_plot};
pub use picture::{Panel, picture};
pub use polar::{PolarPlot, PolarSeries, polar};
pub use quiver::{Arrow, Quiver, quiver};
pub use scale::{Scale, round_below, short, ticks};
pub use square_sketch::{SquareSketch, square_sketch};
pub use svg::{Svg, escaped, finite};
pub use thin::{MOST_POINTS, thinned};
pub use xy::{Band, Bracket, Look, Series, WIDTH, XyPlot, xy};

/// CSS rules of the plots. Their colours are the variables of [`colour_variables`].
pub const STYLE: &str = include_str!("style.css");
