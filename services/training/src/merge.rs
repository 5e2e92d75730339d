//! Weights of parts that were trained apart, in one file; and the mean of runs.

use std::path::PathBuf;

use repose_networks::{
    Models, Weights, WeightsInfo,
    parameters::{DISCRIMINATOR, OBJECT, OUTCOME, RELATIONS, WeightMap},
};

use crate::{error::TrainError, settings::TrainedPart};

/// What weights call the forecast that reads the relation predictor's word: it goes when another predictor comes.
pub const READS_RELATIONS: &str = "success";

impl TrainedPart {
    /// Whether a parameter or a running statistic belongs to this part. The relation predictor belongs to the joint training too.
    pub fn fits(self, parameter: &str) -> bool {
        match self {
            Self::Joint => ![DISCRIMINATOR, OUTCOME].iter().any(|prefix| parameter.starts_with(prefix)),
            Self::Relations => parameter.starts_with(RELATIONS),
            Self::Discriminator => parameter.starts_with(DISCRIMINATOR),
            Self::Outcome => parameter.starts_with(OUTCOME),
        }
    }
}

/// Takes from weights whose relation predictor is another now the forecast that was fitted with the one before.
pub fn forget_reader_of_relations(info: &mut WeightsInfo) {
    if info.forecasts.remove(READS_RELATIONS).is_some() {
        tracing::warn!(
            forecast = READS_RELATIONS,
            "left out, for it was fitted with another relation predictor; `repose train --network success` fits it anew"
        );
    }
}

/// The relation predictor's values, and those of the encoder that it reads.
fn of_relations(values: &WeightMap) -> impl Iterator<Item = (&String, &(Vec<usize>, Vec<f32>))> {
    values.iter().filter(|(name, _)| [OBJECT, RELATIONS].iter().any(|prefix| name.starts_with(prefix)))
}

/// One file's bytes with each part taken from its own weights, recipe and metrics with it. What two parts have is taken from the later. Forecasts come
/// with the outcome network, whose word they read, but for [`READS_RELATIONS`] where the relation predictor is not the one that it came with.
///
/// # Errors
/// When the parts together are no whole set of weights.
pub fn merged(parts: &[(TrainedPart, Weights)]) -> Result<Vec<u8>, TrainError> {
    let mut values = WeightMap::new();
    let mut info = WeightsInfo { recipe: serde_json::json!({}), metrics: serde_json::json!({}), ..WeightsInfo::default() };
    for (part, weights) in parts {
        values.retain(|name, _| !part.fits(name));
        values.extend(weights.values.iter().filter(|(name, _)| part.fits(name)).map(|(name, value)| (name.clone(), value.clone())));
        info.recipe[part.name()] = weights.info.recipe[part.name()].clone();
        info.metrics[part.name()] = weights.info.metrics[part.name()].clone();
        if *part == TrainedPart::Outcome {
            // They read its word.
            info.forecasts = weights.info.forecasts.clone();
        }
    }
    if let Some((_, outcome)) = parts.iter().rfind(|(part, _)| *part == TrainedPart::Outcome)
        && !of_relations(&values).eq(of_relations(&outcome.values))
    {
        forget_reader_of_relations(&mut info);
    }
    let bytes = Weights::to_bytes(&values, &info)?;
    Models::load(&bytes)?;
    Ok(bytes)
}

/// Replaces a part's values by their mean with those of other runs from one ancestor, which is often better than each (Wortsman et al. 2022,
/// "Model soups"). The running statistics are then nobody's: they have to be taken anew.
///
/// # Errors
/// [`TrainError::Mean`] when another run lacks a value of the part or has it in another shape.
pub fn mean_with(values: &mut WeightMap, others: &[(PathBuf, WeightMap)], part: TrainedPart) -> Result<(), TrainError> {
    for (name, (shape, numbers)) in values.iter_mut().filter(|(name, _)| part.fits(name)) {
        for (path, other) in others {
            let same_shape = other.get(name).filter(|(other_shape, _)| other_shape == shape);
            let (_, theirs) = same_shape.ok_or_else(|| TrainError::Mean { path: path.clone(), parameter: name.clone() })?;
            numbers.iter_mut().zip(theirs).for_each(|(sum, x)| *sum += x);
        }
        let count = (1 + others.len()) as f32;
        numbers.iter_mut().for_each(|sum| *sum /= count);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use repose_networks::NetworksConfig;

    use super::*;

    #[test]
    fn the_forecast_that_reads_the_relation_predictor_is_left_out_beside_another_one() {
        let mut own = Weights::embedded().unwrap();
        let forecast = own.info.forecasts.values().next().expect("the program's weights have forecasts").clone();
        own.info.forecasts.insert(READS_RELATIONS.to_owned(), forecast);
        let forecasts = |joint: &Weights| {
            let parts = [TrainedPart::Joint, TrainedPart::Discriminator, TrainedPart::Outcome]
                .map(|part| (part, if part == TrainedPart::Joint { joint.clone() } else { own.clone() }));
            Weights::from_bytes(&merged(&parts).unwrap()).unwrap().info.forecasts
        };
        assert_eq!(forecasts(&own), own.info.forecasts);
        let mut others = own.info.forecasts.clone();
        others.remove(READS_RELATIONS);
        for (changed, kept) in
            [("relations/out/bias", &others), ("object/sa1/linear1/bias", &others), ("prior/out/bias", &own.info.forecasts)]
        {
            let mut joint = own.clone();
            joint.values.get_mut(changed).expect(changed).1[0] += 0.5;
            assert_eq!(&forecasts(&joint), kept, "{changed}");
        }
    }

    #[test]
    fn each_part_comes_from_its_own_file_and_a_missing_one_is_named() {
        let [first, second] = [1, 2].map(|seed| {
            let mut weights = Weights::from_bytes(&Weights::initial(&NetworksConfig::default(), seed).unwrap()).unwrap();
            weights.info.recipe = serde_json::json!({"joint": {"seed": seed}, "discriminator": {"seed": seed}});
            weights
        });
        let parts = [
            (TrainedPart::Joint, first.clone()),
            (TrainedPart::Relations, second.clone()),
            (TrainedPart::Discriminator, second.clone()),
            (TrainedPart::Outcome, second.clone()),
        ];
        let both = Weights::from_bytes(&merged(&parts).unwrap()).unwrap();
        assert_eq!(both.values["object/sa1/linear1/weight"], first.values["object/sa1/linear1/weight"]);
        assert_eq!(both.values["relations/out/weight"], second.values["relations/out/weight"]);
        assert_eq!(both.values["prior/out/weight"], first.values["prior/out/weight"]);
        assert_eq!(both.values["outcome/sa1/linear1/weight"], second.values["outcome/sa1/linear1/weight"]);
        assert_eq!(both.values.len(), first.values.len());
        assert_eq!((&both.info.recipe["joint"]["seed"], &both.info.recipe["discriminator"]["seed"]), (&1.into(), &2.into()));
        let mut mean = first.values.clone();
        mean_with(&mut mean, &[(PathBuf::from("second"), second.values.clone())], TrainedPart::Outcome).unwrap();
        let at = |values: &WeightMap, name: &str| values[name].1[0];
        let name = "outcome/sa1/linear1/weight";
        assert_eq!(at(&mean, name), (at(&first.values, name) + at(&second.values, name)) / 2.0);
        assert_eq!(mean["prior/out/weight"], first.values["prior/out/weight"]);
        let lacking: WeightMap = second.values.into_iter().filter(|(n, _)| n != name).collect();
        let error = mean_with(&mut mean, &[(PathBuf::from("lacking"), lacking)], TrainedPart::Outcome).unwrap_err().to_string();
        assert!(error.contains("lacking") && error.contains(name), "{error}");
        let error = merged(&[(TrainedPart::Joint, first)]).unwrap_err().to_string();
        assert!(error.contains("discriminator/") && error.contains("missing"), "{error}");
    }
}
