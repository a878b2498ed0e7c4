//! Meshes that a URDF names, and the files in which they are: for programs that draw an arm.

use std::path::{Path, PathBuf};

use urdf_rs::Geometry;

/// Names of meshes of links, as they are seen and as they collide, each once; none where the text is
/// no URDF.
pub fn names(urdf: &str) -> Vec<String> {
    let Ok(robot) = urdf_rs::read_from_string(urdf) else {
        return Vec::new();
    };
    let mut names: Vec<String> = robot
        .links
        .into_iter()
        .flat_map(|link| {
            let seen = link.visual.into_iter().map(|visual| visual.geometry);
            let solid = link.collision.into_iter().map(|body| body.geometry);
            seen.chain(solid).collect::<Vec<_>>()
        })
        .filter_map(|geometry| match geometry {
            Geometry::Mesh { filename, .. } => Some(filename),
            _ => None,
        })
        .collect();
    names.sort();
    names.dedup();
    names
}

/// The file that a URDF in the file `urdf` calls `name`: `package://PACKAGE/...` in the nearest folder
/// `PACKAGE` above it or beside those above it, `file:///...` as it is, anything else below the URDF's
/// folder. Nothing where there is no such file.
pub fn file(urdf: &Path, name: &str) -> Option<PathBuf> {
    let folder = urdf.parent()?;
    let found = if let Some(rest) = name.strip_prefix("package://") {
        let (package, path) = rest.split_once('/')?;
        folder.ancestors().find_map(|above| {
            let own = above.file_name().is_some_and(|name| name == package);
            let root = if own {
                above.to_owned()
            } else {
                above.join(package)
            };
            Some(root.join(path)).filter(|file| file.is_file())
        })?
    } else if let Some(path) = name.strip_prefix("file://") {
        PathBuf::from(path)
    } else {
        folder.join(name)
    };
    found.is_file().then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn meshes_are_found_in_packages_and_beside_the_description() {
        let place = std::env::temp_dir().join(format!("meshes-{}", std::process::id()));
        let package = place.join("my_arm");
        std::fs::create_dir_all(package.join("urdf")).unwrap();
        std::fs::create_dir_all(package.join("meshes")).unwrap();
        let link = |name: &str, mesh: &str| {
            format!(
                r#"<link name="{name}"><visual><geometry><mesh filename="{mesh}"/></geometry></visual></link>"#
            )
        };
        let text = format!(
            r#"<robot name="a">{}{}{}</robot>"#,
            link("a", "package://my_arm/meshes/a.stl"),
            link("b", "../meshes/b.stl"),
            link("c", "../meshes/b.stl"),
        );
        let urdf = package.join("urdf/arm.urdf");
        for (file, content) in [
            (urdf.clone(), text.as_str()),
            (package.join("meshes/a.stl"), "a"),
            (package.join("meshes/b.stl"), "b"),
        ] {
            std::fs::write(file, content).unwrap();
        }
        let names = names(&text);
        assert_eq!(names, ["../meshes/b.stl", "package://my_arm/meshes/a.stl"]);
        for (name, content) in names.iter().zip(["b", "a"]) {
            let found = file(&urdf, name).unwrap();
            assert_eq!(std::fs::read_to_string(found).unwrap(), content);
        }
        assert_eq!(file(&urdf, "package://other/meshes/a.stl"), None);
        std::fs::remove_dir_all(&place).unwrap();
    }
}
