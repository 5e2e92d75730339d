//! What each variant of Table 1 is made of.

use repose_proto::place::Variant;

/// Where the candidates of iteration 0 come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Proposals {
    /// Drawn from the learned prior.
    Prior,
    /// The means of the prior's components, without noise.
    PriorMeans,
    /// From the goal's geometry.
    Geometric,
    /// Half from the learned prior, half from the goal's geometry.
    Both,
}

/// What decides whether a goal term holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GoalBy {
    /// The relation predictor, p > ε_ρ.
    Learned,
    /// The rules on completed shapes, by a margin.
    Rule,
    /// The rules decide, and what is to be above its anchor must also be over it; the predictor's probabilities rank.
    RuleRankedByLearned,
}

/// What plays the part of realism.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Realism {
    /// Nothing.
    Unasked,
    /// The scene discriminator, as a constraint f > ε_f and as a cost.
    Discriminator,
    /// Boosted trees on the outcome network and geometry's measures. Geometry constrains the search; this ranks the shortlist at its end,
    /// as a cost, and rejects candidates that are not above ε_f.
    OutcomeRanks,
    /// −log π of the prior, as a cost only.
    PriorDensity,
}

/// What tells whether the object stands by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StandingBy {
    /// Nothing: it is taken to.
    Unasked,
    /// A rule on the faces that it shows and on what it may lean on.
    Rule,
    /// The forecasts of how it stands, which also tell whether a neighbour rests against it; asked for once, before the search.
    Forecast,
}

/// What a variant is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Recipe {
    /// Where candidates come from.
    pub proposals: Proposals,
    /// What decides the goal.
    pub goal_by: GoalBy,
    /// What plays the part of realism.
    pub realism: Realism,
    /// Whether candidates are set down on observed supports and must pass the geometric checks of support and collision.
    pub grounded: bool,
    /// What tells whether the object stands by itself, so that it can be set down as it was seen.
    pub standing_by: StandingBy,
}

impl Recipe {
    /// The recipe of a variant.
    pub fn of(variant: Variant) -> Self {
        let paper = Self {
            proposals: Proposals::Prior,
            goal_by: GoalBy::Learned,
            realism: Realism::Discriminator,
            grounded: false,
            standing_by: StandingBy::Unasked,
        };
        match variant {
            Variant::Full | Variant::FullLambda1 => paper,
            Variant::NoDiscriminator => Self { realism: Realism::Unasked, ..paper },
            Variant::MeanOnly => Self { proposals: Proposals::PriorMeans, ..paper },
            Variant::MdnPrior => Self { realism: Realism::PriorDensity, ..paper },
            Variant::Geometric => Self {
                proposals: Proposals::Geometric,
                goal_by: GoalBy::Rule,
                realism: Realism::Unasked,
                grounded: true,
                standing_by: StandingBy::Rule,
            },
            Variant::Best => Self {
                proposals: Proposals::Both,
                goal_by: GoalBy::RuleRankedByLearned,
                realism: Realism::OutcomeRanks,
                grounded: true,
                standing_by: StandingBy::Forecast,
            },
        }
    }

    /// How many constraints the networks decide.
    pub fn learned_constraints(&self) -> usize {
        usize::from(self.goal_by == GoalBy::Learned) + usize::from(self.realism == Realism::Discriminator)
    }
}
