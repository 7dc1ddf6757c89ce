//! Maximum-entropy inverse reinforcement learning (paper, Experiments, "Simulated Humans"; Ziebart et al. 2008): finds the weights
//! θ of features under which recorded rounds are most likely.
//!
//! A round is a [`Lattice`]: the choices that it offered, step by step, with deterministic outcomes. The maximum-entropy agent's
//! policy is the softmax of its soft values,
//!
//! ```text
//! Q_t(s, a) = θ·φ_t(s, a) + γ V_{t+1}(s'),    V_t(s) = log Σ_a exp Q_t(s, a),    π_t(a|s) = exp(Q_t(s, a) − V_t(s))
//! ```
//!
//! The weights maximise `Σ_rounds Σ_t log π_t(a_t|s_t) − λ/2 |θ|²`. With γ = 1 its gradient is what the person collected minus
//! what the agent expects to: `Σ φ(s_t, a_t) − E_π[Σ φ] − λθ`; with γ < 1 the same holds of each step's discounted rest of the
//! round, which is what is computed here.

use domains::driving;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use thiserror::Error;

/// A round as a lattice of choices: `steps` times, in one of `states` states, one of `actions` actions is taken.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lattice {
    /// Number of states.
    pub states: usize,
    /// Number of actions.
    pub actions: usize,
    /// Number of features of a choice.
    pub features: usize,
    /// State that an action leads to: steps × states × actions.
    pub next: Vec<usize>,
    /// φ: steps × states × actions × features.
    pub phi: Vec<f64>,
    /// State at the start.
    pub start: usize,
    /// What was done, an action for each step.
    pub taken: Vec<usize>,
}

/// A recording that nothing can be learned from.
#[derive(Debug, Error, PartialEq)]
pub enum IrlError {
    /// There is no step in it.
    #[error("no round has a step to learn from")]
    Empty,
    /// A round's parts do not fit together.
    #[error("round {round}: {reason}")]
    Round {
        /// The round, from 0.
        round: usize,
        /// What is wrong with it.
        reason: String,
    },
}

/// How to learn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IrlSettings {
    /// λ: precision of the weights' Gaussian prior.
    pub prior: f64,
    /// γ.
    pub discount: f64,
    /// Steps of gradient ascent at most.
    pub iterations: usize,
    /// Learning ends where no component of the gradient, per recorded step, is larger.
    pub tolerance: f64,
}

impl Default for IrlSettings {
    fn default() -> Self {
        Self {
            prior: 0.05,
            discount: 1.0,
            iterations: 2000,
            tolerance: 1e-6,
        }
    }
}

/// What was learned.
#[derive(Clone, Debug, PartialEq)]
pub struct LearnedWeights {
    /// θ.
    pub weights: Vec<f64>,
    /// Standard error of each weight: the objective's inverse curvature at θ. Infinite where the rounds tell nothing.
    pub error: Vec<f64>,
    /// Mean log-likelihood of a recorded action.
    pub log_likelihood: f64,
    /// Recorded actions.
    pub actions: usize,
    /// Steps of gradient ascent done.
    pub iterations: usize,
    /// Largest component of the gradient at the end, per recorded action.
    pub gradient: f64,
}

impl Lattice {
    /// Steps of the round.
    pub fn steps(&self) -> usize {
        self.taken.len()
    }

    fn choice(&self, step: usize, state: usize, action: usize) -> usize {
        (step * self.states + state) * self.actions + action
    }

    fn phi_of(&self, choice: usize) -> &[f64] {
        &self.phi[choice * self.features..(choice + 1) * self.features]
    }

    /// Why the round's parts do not fit together, if they do not.
    fn fault(&self) -> Option<String> {
        let choices = self.steps() * self.states * self.actions;
        let (next, phi) = (self.next.len(), self.phi.len());
        if next != choices || phi != choices * self.features {
            return Some(format!(
                "{choices} choices of {} features, but {next} outcomes and {phi} features",
                self.features
            ));
        }
        if self.start >= self.states || self.next.iter().any(|state| *state >= self.states) {
            return Some(format!("a state beyond the {} there are", self.states));
        }
        if let Some(at) = self.taken.iter().position(|a| *a >= self.actions) {
            let (action, actions) = (self.taken[at], self.actions);
            return Some(format!("action {action} of {actions} at step {at}"));
        }
        let bad = self.phi.iter().position(|x| !x.is_finite())?;
        let per_step = self.states * self.actions * self.features;
        Some(format!(
            "a feature of {} at step {}",
            self.phi[bad],
            bad / per_step
        ))
    }

    /// The soft policy under weights θ: π_t(a|s) as steps × states × actions.
    pub fn soft_policy(&self, weights: &[f64], discount: f64) -> Vec<f64> {
        let mut policy = vec![0.0; self.next.len()];
        let mut value = vec![0.0; self.states];
        let mut here = vec![0.0; self.states];
        for step in (0..self.steps()).rev() {
            for state in 0..self.states {
                let row = self.choice(step, state, 0);
                let q = &mut policy[row..row + self.actions];
                for (action, q) in q.iter_mut().enumerate() {
                    *q = dot(self.phi_of(row + action), weights)
                        + discount * value[self.next[row + action]];
                }
                let most = q.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                let total: f64 = q.iter().map(|q| (q - most).exp()).sum();
                here[state] = most + total.ln();
                q.iter_mut().for_each(|q| *q = (*q - here[state]).exp());
            }
            std::mem::swap(&mut value, &mut here);
        }
        policy
    }

    /// Adds Σ_t ∇ log π_t(a_t|s_t) to `gradient`; returns Σ_t log π_t(a_t|s_t).
    fn add_gradient(&self, weights: &[f64], discount: f64, gradient: &mut [f64]) -> f64 {
        let policy = self.soft_policy(weights, discount);
        // ∇V_t(s) = Σ_a π_t(a|s) (φ_t(s, a) + γ ∇V_{t+1}(s')), and ∇ log π = ∇Q − ∇V.
        let states = self.states;
        let mut after = vec![0.0; states * self.features];
        let mut here = vec![0.0; states * self.features];
        let mut visited = vec![self.start; self.steps()];
        for step in 1..self.steps() {
            visited[step] =
                self.next[self.choice(step - 1, visited[step - 1], self.taken[step - 1])];
        }
        let mut log_likelihood = 0.0;
        for step in (0..self.steps()).rev() {
            for state in 0..states {
                let out = &mut here[state * self.features..(state + 1) * self.features];
                out.fill(0.0);
                for action in 0..self.actions {
                    let choice = self.choice(step, state, action);
                    let rest = self.next[choice] * self.features;
                    for (k, out) in out.iter_mut().enumerate() {
                        *out +=
                            policy[choice] * (self.phi_of(choice)[k] + discount * after[rest + k]);
                    }
                }
            }
            let (state, action) = (visited[step], self.taken[step]);
            let choice = self.choice(step, state, action);
            let rest = self.next[choice] * self.features;
            for (k, gradient) in gradient.iter_mut().enumerate() {
                *gradient += self.phi_of(choice)[k] + discount * after[rest + k]
                    - here[state * self.features + k];
            }
            log_likelihood += policy[choice].max(f64::MIN_POSITIVE).ln();
            std::mem::swap(&mut after, &mut here);
        }
        log_likelihood
    }

    /// Lets the maximum-entropy agent with weights θ play the round, in place of whoever is recorded in it.
    pub fn play(&mut self, weights: &[f64], discount: f64, random: &mut ChaCha8Rng) {
        let policy = self.soft_policy(weights, discount);
        let mut state = self.start;
        for step in 0..self.steps() {
            let row = self.choice(step, state, 0);
            let mut left = random.random::<f64>();
            let mut action = 0;
            while action + 1 < self.actions && left >= policy[row + action] {
                left -= policy[row + action];
                action += 1;
            }
            self.taken[step] = action;
            state = self.next[row + action];
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Learns the weights from recorded rounds, by gradient ascent with Barzilai and Borwein's step lengths, shortened until the
/// objective (which is concave) does not fall.
///
/// # Errors
/// If there is nothing to learn from, rounds have different features, or a round's parts do not fit together.
pub fn learn(rounds: &[Lattice], settings: &IrlSettings) -> Result<LearnedWeights, IrlError> {
    let actions: usize = rounds.iter().map(Lattice::steps).sum();
    let features = rounds.first().map_or(0, |round| round.features);
    if actions == 0 {
        return Err(IrlError::Empty);
    }
    for (round, lattice) in rounds.iter().enumerate() {
        let fault = if lattice.features == features {
            lattice.fault()
        } else {
            Some(format!(
                "{} features, others have {features}",
                lattice.features
            ))
        };
        if let Some(reason) = fault {
            return Err(IrlError::Round { round, reason });
        }
    }
    let scale = 1.0 / actions as f64;
    // The objective and its gradient, per recorded action.
    let objective = |weights: &[f64], gradient: &mut [f64]| -> (f64, f64) {
        gradient.fill(0.0);
        let fit: f64 = rounds
            .iter()
            .map(|round| round.add_gradient(weights, settings.discount, gradient))
            .sum();
        for (g, w) in gradient.iter_mut().zip(weights) {
            *g = scale * (*g - settings.prior * w);
        }
        let penalty = 0.5 * settings.prior * dot(weights, weights);
        (scale * (fit - penalty), scale * fit)
    };
    let mut weights = vec![0.0; features];
    let mut gradient = vec![0.0; features];
    let (mut value, mut fit) = objective(&weights, &mut gradient);
    let (mut tried, mut tried_gradient) = (weights.clone(), gradient.clone());
    let mut length = 1.0;
    let mut iterations = 0;
    let largest = |g: &[f64]| g.iter().fold(0.0f64, |most, g| most.max(g.abs()));
    while iterations < settings.iterations && largest(&gradient) > settings.tolerance {
        iterations += 1;
        let slope = dot(&gradient, &gradient);
        let accepted = loop {
            for k in 0..features {
                tried[k] = weights[k] + length * gradient[k];
            }
            let (new, new_fit) = objective(&tried, &mut tried_gradient);
            if new >= value + 1e-4 * length * slope {
                break Some((new, new_fit));
            }
            length *= 0.5;
            if length < 1e-12 {
                break None; // as exact as these numbers allow
            }
        };
        let Some((new, new_fit)) = accepted else {
            break;
        };
        let (mut moved, mut turned) = (0.0, 0.0);
        for k in 0..features {
            let step = tried[k] - weights[k];
            moved += step * step;
            turned += step * (gradient[k] - tried_gradient[k]);
        }
        std::mem::swap(&mut weights, &mut tried);
        std::mem::swap(&mut gradient, &mut tried_gradient);
        (value, fit) = (new, new_fit);
        length = if turned > 1e-300 {
            moved / turned
        } else {
            2.0 * length
        };
    }
    // Curvature, by central differences of the gradient.
    let mut curvature = vec![0.0; features * features];
    let (mut above, mut below) = (vec![0.0; features], vec![0.0; features]);
    for k in 0..features {
        let kept = weights[k];
        let step = 1e-4 * (1.0 + kept.abs());
        weights[k] = kept + step;
        objective(&weights, &mut above);
        weights[k] = kept - step;
        objective(&weights, &mut below);
        weights[k] = kept;
        for j in 0..features {
            let slope = (below[j] - above[j]) / (2.0 * step);
            curvature[k * features + j] = slope * actions as f64;
        }
    }
    Ok(LearnedWeights {
        gradient: largest(&gradient),
        error: inverse_diagonal(&mut curvature, features)
            .map(|variance| variance.max(0.0).sqrt())
            .collect(),
        weights,
        log_likelihood: fit,
        actions,
        iterations,
    })
}

/// Diagonal of a square matrix's inverse, by Gauss and Jordan's elimination; infinite if it is singular.
fn inverse_diagonal(matrix: &mut [f64], size: usize) -> impl Iterator<Item = f64> {
    let mut inverse = vec![0.0; size * size];
    for k in 0..size {
        inverse[k * size + k] = 1.0;
    }
    for k in 0..size {
        let pivot = (k..size).max_by(|a, b| {
            matrix[a * size + k]
                .abs()
                .total_cmp(&matrix[b * size + k].abs())
        });
        let pivot = pivot.unwrap_or(k);
        for j in 0..size {
            matrix.swap(k * size + j, pivot * size + j);
            inverse.swap(k * size + j, pivot * size + j);
        }
        let value = matrix[k * size + k];
        if value.abs() < 1e-12 {
            inverse.fill(f64::INFINITY);
            break;
        }
        for j in 0..size {
            matrix[k * size + j] /= value;
            inverse[k * size + j] /= value;
        }
        for row in (0..size).filter(|row| *row != k) {
            let factor = matrix[row * size + k];
            for j in 0..size {
                matrix[row * size + j] -= factor * matrix[k * size + j];
                inverse[row * size + j] -= factor * inverse[k * size + j];
            }
        }
    }
    (0..size).map(move |k| inverse[k * size + k])
}

/// A recorded round of gridworld driving as a lattice over lanes: the other cars drive as recorded whatever the ego car does.
/// `visual` is what was sensed, steps × [`driving::VISUAL`]; `actions` what was done. The last action, whose outcome was not
/// sensed, counts only where `visual` has one row more.
///
/// # Errors
/// If the numbers are no whole rows, there are more actions than rows, or an action does not exist.
pub fn driving_lattice(visual: &[f32], actions: &[usize]) -> Result<Lattice, String> {
    let rows = visual.len() / driving::VISUAL;
    if visual.len() != rows * driving::VISUAL || actions.len() > rows {
        return Err(format!(
            "{} visual numbers for {} actions; {} are a step",
            visual.len(),
            actions.len(),
            driving::VISUAL
        ));
    }
    if let Some(at) = actions.iter().position(|action| *action > driving::SWITCH) {
        return Err(format!("action {} at step {at}, there are 2", actions[at]));
    }
    let steps = actions.len().min(rows.saturating_sub(1));
    let mut lattice = Lattice {
        states: 2,
        actions: 2,
        features: driving::FEATURES,
        start: usize::from(visual.first().is_some_and(|lane| *lane > 0.0)),
        taken: actions[..steps].to_vec(),
        ..Lattice::default()
    };
    for row in visual.chunks_exact(driving::VISUAL).skip(1).take(steps) {
        let cells = std::array::from_fn(|slot| Some(row[1 + slot] * driving::RANGE_CELLS));
        for lane in 0..2 {
            for action in [driving::STAY, driving::SWITCH] {
                let to = lane ^ action;
                lattice.next.push(to);
                let phi = driving::features(to, action, &cells);
                lattice.phi.extend(phi.map(f64::from));
            }
        }
    }
    Ok(lattice)
}
