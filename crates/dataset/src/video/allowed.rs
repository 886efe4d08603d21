//! Protocols and containers that ffmpeg may open. A file that names other files or addresses (a
//! playlist, a session description) is not followed.

use std::path::Path;

/// Containers that cameras, phones and video editors write, as ffmpeg calls its demuxers. None of
/// them reads a second file.
const CONTAINERS: &str = "mov,matroska,avi,mpegts,mpeg,mpegvideo,asf,asf_o,flv,ogg,mxf,nut,dv,dhav,\
                          ivf,obu,av1,h264,hevc,vvc,m4v,vc1,mjpeg,mjpeg_2000,mpjpeg,jpeg_pipe,png_pipe,\
                          gif,apng,yuv4mpegpipe";

/// What comes over the network besides: sessions, playlists, and the sound of their variants.
const NETWORK_CONTAINERS: &str = "rtsp,rtp,sdp,hls,dash,live_flv,mpegtsraw,aac,mp3,ac3,eac3,webvtt";

/// Lists for ffmpeg's options `-protocol_whitelist` and `-format_whitelist`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Allowed {
    pub(super) protocols: String,
    pub(super) containers: String,
}

impl Allowed {
    /// For a file on this computer or a named pipe.
    pub(super) fn file() -> Self {
        Self { protocols: "file".to_owned(), containers: CONTAINERS.to_owned() }
    }

    /// For a stream: `-`, an address, or a named pipe.
    pub(super) fn stream(source: &Path) -> Self {
        if source.as_os_str() == "-" {
            // `-` is the protocol `fd` since ffmpeg 6.1.
            return Self { protocols: "pipe,fd".to_owned(), ..Self::file() };
        }
        match source.to_str().and_then(scheme) {
            None | Some("file") => Self::file(),
            Some(scheme) => Self {
                protocols: protocols_of(scheme).to_owned(),
                containers: format!("{CONTAINERS},{NETWORK_CONTAINERS}"),
            },
        }
    }
}

/// Letters before the first colon of an address, which ffmpeg takes for its protocol.
fn scheme(address: &str) -> Option<&str> {
    let (before, _) = address.split_once("://")?;
    before.split(|c: char| !c.is_ascii_alphanumeric() && !"+-.".contains(c)).next()
}

/// Protocols that an address needs: its own and those below it. Never `file`, so that what a server
/// sends cannot name a file of this computer.
fn protocols_of(scheme: &str) -> &str {
    match scheme {
        "rtsp" => "rtsp,rtp,srtp,udp,tcp",
        "rtsps" => "rtsps,rtsp,rtp,srtp,udp,tcp,tls",
        "rtp" => "rtp,udp",
        "srtp" => "srtp,rtp,udp",
        // Servers send on from http to https; not the other way round.
        "http" => "http,https,tls,tcp,httpproxy,crypto",
        "https" => "https,tls,tcp,httpproxy,crypto",
        "rtmp" => "rtmp,tcp",
        "rtmpe" => "rtmpe,ffrtmpcrypt,tcp",
        "rtmps" => "rtmps,tls,tcp",
        "rtmpt" => "rtmpt,ffrtmphttp,http,tcp",
        "rtmpte" => "rtmpte,ffrtmpcrypt,ffrtmphttp,http,tcp",
        "rtmpts" => "rtmpts,ffrtmphttp,https,tls,tcp",
        "mmsh" => "mmsh,http,tcp",
        "mmst" => "mmst,tcp",
        "ftp" => "ftp,tcp",
        "tls" => "tls,tcp",
        alone => alone,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn protocols(source: &str) -> String {
        Allowed::stream(Path::new(source)).protocols
    }

    #[test]
    fn an_address_gets_its_own_protocols_and_no_file() {
        assert_eq!(protocols("rtsp://camera/1"), "rtsp,rtp,srtp,udp,tcp");
        assert_eq!(protocols("https://host/a.m3u8"), "https,tls,tcp,httpproxy,crypto");
        assert_eq!(protocols("srt://host:1"), "srt");
        assert_eq!(protocols("udp://@:1234"), "udp");
        assert_eq!(protocols("-"), "pipe,fd");
        for address in ["http://a/b", "rtsp://a/b", "rtmpte://a/b", "what://a/b"] {
            let allowed = protocols(address);
            assert!(allowed.split(',').all(|name| name != "file" && name != "concat"), "{allowed}");
        }
    }

    #[test]
    fn protocols_that_wrap_others_get_nothing_to_wrap() {
        assert_eq!(protocols("concat:http://a/b|file:///etc/passwd"), "concat");
        assert_eq!(protocols("subfile,,start,0,end,9,,:http://a"), "subfile");
        assert_eq!(protocols("cache:file:///a"), "cache");
    }

    #[test]
    fn files_and_pipes_get_containers_that_name_no_others() {
        for allowed in [Allowed::file(), Allowed::stream(Path::new("/tmp/camera"))] {
            assert_eq!(allowed.protocols, "file");
            let mut names = allowed.containers.split(',');
            let following =
                ["hls", "dash", "concat", "sdp", "imf", "lavfi", "image2", "webm_dash_manifest"];
            assert!(names.all(|name| !following.contains(&name)), "{}", allowed.containers);
        }
        assert_eq!(Allowed::stream(Path::new("file:///a/b.mp4")), Allowed::file());
        assert!(Allowed::stream(Path::new("http://a/b")).containers.contains(",hls,"));
    }
}
