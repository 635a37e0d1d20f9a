//! Picture files of any content: decoded or refused.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pivotsight::frame::{Channel, Picture};

fuzz_target!(|bytes: &[u8]| {
    if let Ok(picture) = Picture::decode("fed.png", bytes) {
        picture.into_frame(Channel::Auto).to_eight();
    }
});
