//! From a scene file to a scene.

use std::path::Path;

use echosplat_model::Pose;
use glam::{DQuat, DVec3, EulerRot};
use toml::Spanned;

use super::ellipsoid::Ellipsoid;
use super::file::{BlockEntry, HeightFieldEntry, MeshEntry, RodEntry, SceneFile};
use super::shape::{Rod, Shape};
use super::tree::Tree;
use super::{Material, Part, Plane, Scene, SceneError, SurveyHints, ViewpointHints, mesh};

/// Names that [`Scene::named`] knows, each a file under `config/scenes/`.
pub const BUILT_IN_SCENES: [(&str, &str); 11] = [
    (
        "fence",
        include_str!("../../../../config/scenes/fence.toml"),
    ),
    (
        "truss",
        include_str!("../../../../config/scenes/truss.toml"),
    ),
    ("pier", include_str!("../../../../config/scenes/pier.toml")),
    (
        "pipeline",
        include_str!("../../../../config/scenes/pipeline.toml"),
    ),
    ("wall", include_str!("../../../../config/scenes/wall.toml")),
    (
        "empty",
        include_str!("../../../../config/scenes/empty.toml"),
    ),
    (
        "fence-specular",
        include_str!("../../../../config/scenes/fence-specular.toml"),
    ),
    (
        "pier-specular",
        include_str!("../../../../config/scenes/pier-specular.toml"),
    ),
    (
        "dolphin",
        include_str!("../../../../config/scenes/dolphin.toml"),
    ),
    (
        "lander",
        include_str!("../../../../config/scenes/lander.toml"),
    ),
    (
        "quay-corner",
        include_str!("../../../../config/scenes/quay-corner.toml"),
    ),
];

const MAX_SCENE_BYTES: u64 = 16 << 20;
const MAX_SOLID_COUNT: usize = 100_000;
const MAX_HEIGHT_FIELD_CELLS: f64 = 1e6;

impl Scene {
    /// A built-in scene; [`BUILT_IN_SCENES`] lists them.
    ///
    /// # Errors
    /// If there is none of that name; the message lists those there are.
    pub fn named(name: &str) -> Result<Self, SceneError> {
        let Some((_, text)) = BUILT_IN_SCENES.iter().find(|(known, _)| *known == name) else {
            return Err(SceneError::UnknownName {
                name: name.to_owned(),
                known: BUILT_IN_SCENES.map(|(known, _)| known).join(", "),
            });
        };
        Self::build(text, None, name)
    }

    /// From a file; meshes are looked for beside it.
    ///
    /// # Errors
    /// Names the file, and where in it and what is wrong.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, SceneError> {
        Self::load_with_text(path).map(|(scene, _)| scene)
    }

    /// The same, with what the file says: one that is a pipe can be read once.
    ///
    /// # Errors
    /// As [`Scene::load`].
    pub fn load_with_text(path: impl AsRef<Path>) -> Result<(Self, String), SceneError> {
        let path = path.as_ref();
        let text = echosplat_input::read(path, MAX_SCENE_BYTES);
        let text = text.map_err(|source| mesh::unreadable(path, source))?;
        let origin = path.display().to_string();
        let text = String::from_utf8(text).map_err(|error| SceneError::Toml {
            origin: origin.clone(),
            message: format!("not UTF-8 text: {error}"),
        })?;
        let scene = Self::build(&text, path.parent(), &origin)?;
        Ok((scene, text))
    }

    /// From text; meshes are looked for under `base_dir` or, without one, the working directory.
    ///
    /// # Errors
    /// Names line and key, what is wrong and what is allowed.
    pub fn parse(toml: &str, base_dir: Option<&Path>) -> Result<Self, SceneError> {
        Self::build(toml, base_dir, "scene")
    }

    /// A scene of nothing but the triangles of an STL, OBJ or PLY file, in metres.
    ///
    /// # Errors
    /// Names the file and what is wrong with it.
    pub fn from_mesh(path: impl AsRef<Path>) -> Result<Self, SceneError> {
        let path = path.as_ref();
        let bytes = echosplat_input::read(path, mesh::MAX_MESH_BYTES);
        Self::of_mesh(
            &bytes.map_err(|source| mesh::unreadable(path, source))?,
            path,
        )
    }

    /// The same of a file's bytes; `path` is where they are from.
    ///
    /// # Errors
    /// As [`Scene::from_mesh`].
    pub fn of_mesh(bytes: &[u8], path: &Path) -> Result<Self, SceneError> {
        let origin = path.display().to_string();
        let mut builder = Builder::new("", None, &origin);
        for triangle in mesh::of_bytes(bytes, path)? {
            builder.push_triangle(triangle, solid(1.0, 0.0));
        }
        Ok(builder.finish(&origin, SurveyHints::default(), ViewpointHints::default()))
    }

    fn build(text: &str, base_dir: Option<&Path>, origin: &str) -> Result<Self, SceneError> {
        let file: SceneFile = toml::from_str(text).map_err(|error| SceneError::Toml {
            origin: origin.to_owned(),
            message: error.to_string(),
        })?;
        let mut builder = Builder::new(text, base_dir, origin);
        builder.add_all(&file)?;
        Ok(builder.finish(&file.name, file.survey, file.viewpoints))
    }
}

struct Builder<'a> {
    text: &'a str,
    base_dir: Option<&'a Path>,
    origin: &'a str,
    parts: Vec<Part>,
    planes: Vec<Plane>,
}

impl<'a> Builder<'a> {
    fn new(text: &'a str, base_dir: Option<&'a Path>, origin: &'a str) -> Self {
        Self {
            text,
            base_dir,
            origin,
            parts: Vec::new(),
            planes: Vec::new(),
        }
    }

    fn finish(self, name: &str, survey: SurveyHints, viewpoints: ViewpointHints) -> Scene {
        let boxes: Vec<_> = self.parts.iter().map(|part| part.shape.bounds()).collect();
        Scene {
            name: name.to_owned(),
            tree: Tree::build(&boxes),
            parts: self.parts,
            planes: self.planes,
            survey,
            viewpoints,
        }
    }

    fn add_all(&mut self, file: &SceneFile) -> Result<(), SceneError> {
        let rods = file.capsule.len() + file.cylinder.len();
        let round = file.sphere.len() + file.ellipsoid.len();
        let count = rods + round + file.block.len() + file.plane.len();
        if count > MAX_SOLID_COUNT {
            let message = format!("{count} solids; at most {MAX_SOLID_COUNT} are allowed");
            return Err(SceneError::Toml {
                origin: self.origin.to_owned(),
                message,
            });
        }
        for entry in &file.sphere {
            let entry = entry.get_ref();
            let shape = Shape::Sphere {
                center: entry.center_m,
                radius: entry.radius_m,
            };
            self.push(shape, solid(entry.reflectivity, entry.specular));
        }
        for entry in &file.capsule {
            let rod = self.rod(entry)?;
            self.push(Shape::Capsule(rod.0), rod.1);
        }
        for entry in &file.cylinder {
            let rod = self.rod(entry)?;
            self.push(Shape::Cylinder(rod.0), rod.1);
        }
        for entry in &file.block {
            self.push_block(entry.get_ref());
        }
        for entry in &file.ellipsoid {
            let entry = entry.get_ref();
            let shape = Shape::Ellipsoid(Ellipsoid {
                center: entry.center_m,
                semi_axes: entry.semi_axes_m,
                world_from_own: rotation(entry.yaw_pitch_roll_deg),
            });
            self.push(shape, solid(entry.reflectivity, entry.specular));
        }
        for entry in &file.plane {
            let entry = entry.get_ref();
            self.planes.push(Plane {
                point: entry.point_m,
                normal: entry.normal,
                material: material(entry.reflectivity, entry.specular, entry.seabed),
            });
        }
        for entry in &file.height_field {
            self.push_height_field(entry)?;
        }
        for entry in &file.mesh {
            self.push_mesh(entry.get_ref())?;
        }
        Ok(())
    }

    fn push(&mut self, shape: Shape, material: Material) {
        self.parts.push(Part { shape, material });
    }

    fn rod(&self, entry: &Spanned<RodEntry>) -> Result<(Rod, Material), SceneError> {
        let rod = entry.get_ref();
        let material = solid(rod.reflectivity, rod.specular);
        Rod::between(rod.from_m, rod.to_m, rod.radius_m)
            .map(|rod| (rod, material))
            .ok_or_else(|| {
                self.error(
                    entry,
                    "from_m and to_m are the same place; a sphere is `[[sphere]]`",
                )
            })
    }

    fn push_block(&mut self, entry: &BlockEntry) {
        let shape = Shape::Block {
            center: entry.center_m,
            half: 0.5 * entry.size_m,
            world_from_block: rotation(entry.yaw_pitch_roll_deg),
        };
        self.push(shape, solid(entry.reflectivity, entry.specular));
    }

    fn push_height_field(&mut self, entry: &Spanned<HeightFieldEntry>) -> Result<(), SceneError> {
        let field = entry.get_ref();
        let counts = field
            .size_m
            .map(|size| (size / field.cell_m).ceil().max(1.0));
        if !(counts[0] * counts[1] <= MAX_HEIGHT_FIELD_CELLS) {
            let message = format!(
                "cell_m {} cuts size_m into {} × {} cells; at most {MAX_HEIGHT_FIELD_CELLS} are allowed",
                field.cell_m, counts[0], counts[1]
            );
            return Err(self.error(entry, &message));
        }
        let material = material(field.reflectivity, field.specular, field.seabed);
        for triangle in mesh::height_field(field, counts.map(|count| count as usize)) {
            self.push_triangle(triangle, material);
        }
        Ok(())
    }

    fn push_mesh(&mut self, entry: &MeshEntry) -> Result<(), SceneError> {
        let path = self
            .base_dir
            .map_or_else(|| entry.file.clone(), |base_dir| base_dir.join(&entry.file));
        let world_from_mesh = Pose {
            rotation: rotation(entry.yaw_pitch_roll_deg),
            translation_m: entry.translation_m,
        };
        let material = material(entry.reflectivity, entry.specular, entry.seabed);
        for triangle in mesh::load(&path)? {
            let placed = triangle.map(|corner| world_from_mesh * (corner * entry.scale));
            self.push_triangle(placed, material);
        }
        Ok(())
    }

    /// Triangles without an area reflect nothing and are left out.
    fn push_triangle(&mut self, [a, b, c]: [DVec3; 3], material: Material) {
        let (edge_1, edge_2) = (b - a, c - a);
        if let Some(normal) = edge_1.cross(edge_2).try_normalize() {
            let shape = Shape::Triangle {
                corner: a,
                edge_1,
                edge_2,
                normal,
            };
            self.push(shape, material);
        }
    }

    fn error<T>(&self, entry: &Spanned<T>, message: &str) -> SceneError {
        let start = entry.span().start.min(self.text.len());
        let line = 1 + self.text.as_bytes()[..start]
            .iter()
            .filter(|&&b| b == b'\n')
            .count();
        SceneError::Solid {
            origin: self.origin.to_owned(),
            line,
            message: message.to_owned(),
        }
    }
}

fn material(reflectivity: f64, specular: f64, is_seabed: bool) -> Material {
    Material {
        reflectivity,
        specular,
        is_seabed,
    }
}

fn solid(reflectivity: f64, specular: f64) -> Material {
    material(reflectivity, specular, false)
}

fn rotation(yaw_pitch_roll_deg: DVec3) -> DQuat {
    let [yaw, pitch, roll] = yaw_pitch_roll_deg.to_array().map(f64::to_radians);
    DQuat::from_euler(EulerRot::ZYX, yaw, pitch, roll)
}
