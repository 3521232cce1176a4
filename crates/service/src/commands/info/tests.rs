use super::*;

fn error_of(file: &Path) -> String {
    all_facts(&[file.to_owned()]).unwrap_err().to_string()
}

#[test]
fn what_cannot_be_read_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    assert!(error_of(folder.path()).contains("give a regular file"));
    assert!(error_of(Path::new("/dev/zero")).contains("give a regular file"));
    let empty = folder.path().join("a.mcap");
    std::fs::write(&empty, b"").unwrap();
    assert!(error_of(&empty).contains("empty"));
    assert!(error_of(&folder.path().join("none")).contains("none"));
}

#[test]
fn a_trajectory_says_its_span() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.tum");
    std::fs::write(&file, "# t\n1.5 0 0 -1 0 0 0 1\n3.5 2 0 0 0 0 0 1\n").unwrap();
    let facts = all_facts(&[file]).unwrap().remove(0);
    assert_eq!(facts["poses"], 2);
    assert_eq!(facts["pose_span"]["seconds"], 2.0);
    assert!(lines(&facts).contains("seconds 2"), "{}", lines(&facts));
}
