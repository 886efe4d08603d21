use super::*;

#[test]
fn the_printed_specification_reads_back() {
    let spec = Spec { seed: 7, ..Spec::default() };
    let text = spec.to_toml();
    assert_eq!(Spec::from_toml(&text, "printed").expect("readable"), spec);
    assert!(text.contains("# Width of the pictures [px].\n# Range: 16 to 8192.\nwidth = 320"));
}

#[test]
fn an_empty_specification_is_the_default() {
    assert_eq!(Spec::from_toml("", "empty").expect("readable"), Spec::default());
}

#[test]
fn unknown_keys_and_values_out_of_range_are_named() {
    let message = |text: &str| Spec::from_toml(text, "a.toml").expect_err(text).to_string();
    let unknown = message("[camera]\nwidht = 3");
    assert!(unknown.contains("widht") && unknown.contains("line 2"), "{unknown}");
    assert!(unknown.contains("`width`"), "{unknown}");
    assert!(message("[colour]\nx = 1").contains("colour"));
    assert!(
        message("[camera]\nwidth = 3").contains("camera.width = 3 is out of range: 16 to 8192")
    );
    assert!(message("[room]\nsize = [5.0, 4.0]").contains("line 2"));
    assert!(message("[exposure]\nresponse = \"gamma\"").contains("reinhard"));
    assert!(message("[motion]\nspeed = nan").contains("motion.speed = NaN"));
    assert!(
        message("[exposure]\nshutter_minimum = 0.5\nshutter_maximum = 0.2").contains("at most")
    );
}
