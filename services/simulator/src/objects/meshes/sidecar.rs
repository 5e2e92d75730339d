//! What someone says about a mesh in a file beside it.
//!
//! `NAME.toml` beside `NAME.obj`, or `object.toml` in its folder, may give any of `name`, `mass_kg`, `friction`, `density_kg_m3`, `scale`
//! and `up`. Without a mass there, the `<mass value="…"/>` of a `model.urdf` in the folder counts.

use std::path::Path;

use serde::Deserialize;

use super::error::{MeshError, MeshProblem};
use super::settings::UpAxis;

/// What a sidecar may say; what it does not say comes from the settings.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sidecar {
    /// What labels and logs call it.
    pub name: Option<String>,
    /// Mass.
    pub mass_kg: Option<f32>,
    /// Coulomb friction coefficient.
    pub friction: Option<f32>,
    /// Mass per enclosed volume, where no mass is given.
    pub density_kg_m3: Option<f32>,
    /// Metres per unit of the file.
    pub scale: Option<f32>,
    /// Which way is up in the file.
    pub up: Option<UpAxis>,
}

/// The sidecar of a mesh; empty when there is none.
///
/// # Errors
/// [`MeshError`] that names the sidecar when it is there but not valid.
pub fn sidecar_of(mesh: &Path) -> Result<Sidecar, MeshError> {
    let mut sidecar = Sidecar::default();
    for path in [mesh.with_extension("toml"), mesh.with_file_name("object.toml")] {
        if let Some(text) = text_of(&path)? {
            sidecar = toml::from_str(&text).map_err(|e| MeshProblem::Format { format: "TOML", message: e.to_string() }.at(&path))?;
            sidecar.validated().map_err(|problem| problem.at(&path))?;
            break;
        }
    }
    if sidecar.mass_kg.is_none() {
        let path = mesh.with_file_name("model.urdf");
        if let Some(text) = text_of(&path)? {
            sidecar.mass_kg = urdf_mass_kg(&text).map_err(|problem| problem.at(&path))?;
        }
    }
    Ok(sidecar)
}

impl Sidecar {
    fn validated(&self) -> Result<(), MeshProblem> {
        let fields = [("mass_kg", self.mass_kg), ("friction", self.friction), ("density_kg_m3", self.density_kg_m3), ("scale", self.scale)];
        fields.into_iter().try_for_each(|(field, value)| value.map_or(Ok(()), |got| positive(field, got)))
    }
}

/// Checks that a number is finite and above 0.
///
/// # Errors
/// [`MeshProblem::OutOfRange`].
pub fn positive(field: &'static str, got: f32) -> Result<(), MeshProblem> {
    if got.is_finite() && got > 0.0 { Ok(()) } else { Err(MeshProblem::OutOfRange { field, got }) }
}

/// The mass of all links together; `None` when no link has one.
fn urdf_mass_kg(text: &str) -> Result<Option<f32>, MeshProblem> {
    let invalid = |message: String| MeshProblem::Format { format: "URDF", message };
    let document = roxmltree::Document::parse(text).map_err(|e| invalid(e.to_string()))?;
    let mut mass_kg = None;
    for node in document.descendants().filter(|n| n.has_tag_name("mass")) {
        let value = node.attribute("value").ok_or_else(|| invalid("a mass without value".to_owned()))?;
        let value: f32 = value.trim().parse().map_err(|e| invalid(format!("mass `{value}`: {e}")))?;
        positive("mass", value)?;
        mass_kg = Some(mass_kg.unwrap_or(0.0) + value);
    }
    Ok(mass_kg)
}

fn text_of(path: &Path) -> Result<Option<String>, MeshError> {
    match std::fs::read_to_string(path) {
        Ok(text) => Ok(Some(text)),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(MeshProblem::Io(e).at(path)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_urdf_gives_its_mass_or_says_what_is_wrong() {
        let urdf = |mass: &str| format!("<robot name=\"a\"><link name=\"b\"><inertial><mass value=\"{mass}\"/></inertial></link></robot>");
        assert_eq!(urdf_mass_kg(&urdf("0.414")).expect("valid"), Some(0.414));
        assert_eq!(urdf_mass_kg("<robot name=\"a\"/>").expect("valid"), None);
        assert!(matches!(urdf_mass_kg(&urdf("-1")), Err(MeshProblem::OutOfRange { field: "mass", .. })));
        assert!(matches!(urdf_mass_kg(&urdf("heavy")), Err(MeshProblem::Format { .. })));
        assert!(matches!(urdf_mass_kg("<robot"), Err(MeshProblem::Format { .. })));
    }

    #[test]
    fn the_mesh_s_own_sidecar_goes_before_the_folder_s_and_both_before_the_urdf() {
        let folder = tempfile::tempdir().expect("a folder");
        let mesh = folder.path().join("thing.obj");
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("written");
        assert_eq!(sidecar_of(&mesh).expect("none"), Sidecar::default());
        write("model.urdf", "<robot><mass value=\"0.2\"/></robot>");
        write("object.toml", "name = \"teapot\"\nup = \"y\"");
        let found = sidecar_of(&mesh).expect("valid");
        assert_eq!((found.name.as_deref(), found.mass_kg, found.up), (Some("teapot"), Some(0.2), Some(UpAxis::Y)));
        write("thing.toml", "mass_kg = 0.7");
        assert_eq!(sidecar_of(&mesh).expect("valid"), Sidecar { mass_kg: Some(0.7), ..Sidecar::default() });
        write("thing.toml", "mass = 0.7");
        let error = sidecar_of(&mesh).expect_err("an unknown field").to_string();
        assert!(error.contains("thing.toml") && error.contains("mass"), "{error}");
        write("thing.toml", "friction = nan");
        assert!(sidecar_of(&mesh).expect_err("not a number").to_string().contains("friction"));
    }
}
