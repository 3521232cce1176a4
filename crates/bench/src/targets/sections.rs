//! Parts of the bench.

/// What is asked of maps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Section {
    /// Single maps against the truth.
    Accuracy,
    /// Single maps of pings as a real unit hears them.
    Field,
    /// What maps say of their own certainty.
    Certainty,
    /// Wrong poses must spoil the map.
    Shift,
    /// More pings must not.
    More,
    /// The map while the dive goes on must be about as good as if it ended there.
    Live,
    /// More work must not spoil the map.
    Work,
    /// Work per ping over the length of a dive.
    Length,
    /// The same bits on any number of threads.
    Threads,
    /// The same map wherever the dive takes place.
    Frames,
    /// Echoes heard a second time must leave nothing in the map.
    Again,
    /// Scenes that no setting was chosen on.
    Own,
    /// The paper's method on the same dive.
    Paper,
}

impl Section {
    /// In the order of the report.
    pub(crate) const ALL: [Self; 13] = [
        Self::Accuracy,
        Self::Field,
        Self::Certainty,
        Self::Shift,
        Self::More,
        Self::Live,
        Self::Work,
        Self::Length,
        Self::Threads,
        Self::Frames,
        Self::Again,
        Self::Own,
        Self::Paper,
    ];

    /// As on the command line.
    #[must_use]
    pub(crate) fn as_str(self) -> &'static str {
        match self {
            Self::Accuracy => "accuracy",
            Self::Field => "field",
            Self::Certainty => "certainty",
            Self::Shift => "shift",
            Self::More => "more",
            Self::Live => "live",
            Self::Work => "work",
            Self::Length => "length",
            Self::Threads => "threads",
            Self::Frames => "frames",
            Self::Again => "again",
            Self::Own => "own",
            Self::Paper => "paper",
        }
    }

    pub(super) fn title(self) -> &'static str {
        match self {
            Self::Accuracy => "Accuracy",
            Self::Field => "As a real unit hears it",
            Self::Certainty => "How sure maps say they are",
            Self::Shift => "Poses shifted in time",
            Self::More => "More pings",
            Self::Live => "Live against finished",
            Self::Work => "More work",
            Self::Length => "Length of the dive",
            Self::Threads => "Number of threads",
            Self::Frames => "Where it takes place",
            Self::Again => "Echoes heard again",
            Self::Own => "Other scenes",
            Self::Paper => "Against the paper's method",
        }
    }

    /// What was done.
    pub(super) fn about(self) -> &'static str {
        match self {
            Self::Accuracy => {
                "The finished map of each dive against its truth. CD and HD in metres; where there \
                 is a seabed, those of the structure. What is aimed at for pan and level dives, an \
                 elevation sigma within twice its bound, is not measured here."
            }
            Self::Field => {
                "As above, at the noise level field: echoes 5 to 30 dB over the noise that fall with \
                 range, one look of speckle, automatic gain, poses that drift away for good."
            }
            Self::Certainty => {
                "Finished maps of surveys of fence, wall, pier and pipeline, all four of a seed pooled. \
                 The distance to truth over sigma along truth's normal; its root mean square over \
                 that of sigma in tenths by sigma, the one furthest from 1 either way; and the \
                 probability of surface within 0.10 m against how often there is some, ambiguous \
                 places included, in ten groups of at least 300."
            }
            Self::Shift => {
                "The same pings with poses of one second later: if the map comes from the data, it \
                 is spoilt. CD of that map over CD of the right one."
            }
            Self::More => {
                "The first quarter, half and three quarters of a dive, and all of it, each \
                 finished: the share of map points within 10 cm of truth, and how much of it any \
                 longer dive has lost against a shorter one."
            }
            Self::Live => {
                "The live map at 30, 40 … 100 % of a dive (the last one before its end) beside that \
                 of the same dive cut there and ended, both against what the whole dive sees. The \
                 99th percentile is the larger of the two directed ones. Of each seed the worst of \
                 these moments."
            }
            Self::Work => {
                "One dive with 1, 2, 4 and 8 times the pairs of the default that a ping allows: how \
                 much worse the finished map gets from any of them to any greater one. And with a \
                 third of them, which is what a computer with a third of the speed could do."
            }
            Self::Length => {
                "One motion, cut after 60, 120, 240 and 480 s: counted work per ping (voxel observations \
                 and Gaussian–bin pairs, both at their count), without the finish and of the \
                 finish. Flat is the most over the least, minus 1. And a dive longer than memory: \
                 only 1,024 of its pings remembered."
            }
            Self::Threads => "Whether one thread and two give the same bits.",
            Self::Frames => {
                "The same pings with poses moved or turned in the world; the map is moved and \
                 turned back. Mean of the two directed mean distances between the confident points \
                 of both maps."
            }
            Self::Again => {
                "One dive under surfaces of the water at 16 heights, and one with copies of every echo \
                 at distances and levels over the range that the program looks for: the largest \
                 share of confident Gaussians that are false, and the CD there."
            }
            Self::Own => {
                "Scenes of other sizes, distances and kinds, on which no setting was chosen, \
                 judged like the row that is most alike."
            }
            Self::Paper => {
                "Both methods on one dive in images. The paper's processor seconds over those after \
                 which a map of the mapper, live or finished, has the paper's final CD or less; and \
                 the likelihood gain of the finished map on pings that neither method has seen, \
                 nats per bin, with gain, floor and number of looks fitted to each."
            }
        }
    }
}
