//! What a user may choose about splatting.

/// Where a fragment is clipped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Clip {
    /// Every fragment on its own flat disk, as in the paper (Wicke 2004 §3.3).
    Fragment,
    /// One test for each group of fragments that form one surface, on that surface.
    #[default]
    Surface,
}

impl Clip {
    /// Every choice.
    pub const ALL: [Self; 2] = [Self::Fragment, Self::Surface];

    /// Its name in flags, charts and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fragment => "fragment",
            Self::Surface => "surface",
        }
    }

    /// What it does, in a line of help.
    pub fn summary(self) -> &'static str {
        match self {
            Self::Fragment => "clip every fragment on its flat disk (the paper)",
            Self::Surface => "clip each surface once, on its curved shape",
        }
    }
}

/// How a point is found to be inside or outside of a leaf that is represented by surfels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Inside {
    /// The side of the nearest surfel's plane.
    Nearest,
    /// The two nearest surfels' planes (Wicke 2004 eqs. 3-5).
    TwoNearest,
    /// Outside where any partner's plane says so (Zwicker 2004); wrong at concave corners.
    AnyPlane,
    /// The sign of the planes' weighted mean.
    Blend,
    /// The sign of the weighted mean of curved surfels.
    #[default]
    Curved,
}

impl Inside {
    /// Every choice, the simplest first.
    pub const ALL: [Self; 5] = [Self::Nearest, Self::TwoNearest, Self::AnyPlane, Self::Blend, Self::Curved];

    /// Its name in flags, charts and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nearest => "nearest",
            Self::TwoNearest => "two-nearest",
            Self::AnyPlane => "any-plane",
            Self::Blend => "blend",
            Self::Curved => "curved",
        }
    }

    /// What it does, in a line of help.
    pub fn summary(self) -> &'static str {
        match self {
            Self::Nearest => "side of the nearest surfel's plane",
            Self::TwoNearest => "the two nearest surfels' planes (the paper)",
            Self::AnyPlane => "outside where any partner's plane says so; wrong at concave corners",
            Self::Blend => "weighted mean of the planes",
            Self::Curved => "weighted mean of curved surfels",
        }
    }
}

/// What holds for a leaf whose surface is near an edge surfel but which has no partner at the point asked about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Unknown {
    /// The paper's rule (Wicke 2004 §3.3.1): the leaf drops out of the expression; partners are edge surfels alone.
    Paper,
    /// Each edge surfel keeps the part of the expression that is undecided there; partners are all surfels of its leaves.
    #[default]
    Resolved,
}

impl Unknown {
    /// Every choice.
    pub const ALL: [Self; 2] = [Self::Paper, Self::Resolved];

    /// Its name in flags, charts and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Resolved => "resolved",
        }
    }

    /// What it does, in a line of help.
    pub fn summary(self) -> &'static str {
        match self {
            Self::Paper => "a leaf without partners drops out of the expression (the paper)",
            Self::Resolved => "every edge surfel keeps the undecided part of the expression",
        }
    }
}

/// Where clipping partners are searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Partners {
    /// Among surfels that meet in a cell of the picture (Wicke 2004 §3.2); anew for every view.
    ClipBuffer,
    /// Among surfels that meet in space; kept from frame to frame.
    #[default]
    ObjectSpace,
}

impl Partners {
    /// Every choice.
    pub const ALL: [Self; 2] = [Self::ClipBuffer, Self::ObjectSpace];

    /// Its name in flags, charts and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::ClipBuffer => "clip-buffer",
            Self::ObjectSpace => "object-space",
        }
    }

    /// What it does, in a line of help.
    pub fn summary(self) -> &'static str {
        match self {
            Self::ClipBuffer => "surfels that meet in a cell of the picture (the paper)",
            Self::ObjectSpace => "surfels that meet in space; kept from frame to frame",
        }
    }
}

/// All choices together; the default is the most accurate of each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct SplatSettings {
    /// Where a fragment is clipped.
    pub clip: Clip,
    /// How a point is found to be inside.
    pub inside: Inside,
    /// What holds for a leaf without partners.
    pub unknown: Unknown,
    /// Where partners are searched.
    pub partners: Partners,
}

impl SplatSettings {
    /// The paper's own choices (Wicke 2004).
    pub const PAPER: Self = Self {
        clip: Clip::Fragment,
        inside: Inside::TwoNearest,
        unknown: Unknown::Paper,
        partners: Partners::ClipBuffer,
    };
}
