use super::*;

#[test]
fn a_decoder_that_panics_is_expected_until_it_has_ended() {
    assert_eq!(panics_caught(is_decoding), Some(true));
    assert_eq!(panics_caught::<()>(|| panic!("a damaged stream")), None);
    assert!(!is_decoding());
}
