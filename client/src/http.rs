//! Just enough of HTTP/1.1 to ask a server for JSON: one request a connection, with limits on size and time.

use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;
use welkin_proto::error::ApiError;
use welkin_proto::wire::WorldSummary;

use crate::error::ClientError;
use crate::url::ServerUrl;

/// From the first byte sent to the last received.
const ANSWER_LIMIT: Duration = Duration::from_secs(10);
const CONNECT_LIMIT: Duration = Duration::from_secs(5);
const HEAD_BYTES_MAX: usize = 32 << 10;
const BODY_BYTES_MAX: usize = 4 << 20;

/// A connection to the server.
///
/// Errors: [`ClientError::Unreachable`], [`ClientError::TimedOut`].
pub(crate) async fn open(server: &ServerUrl) -> Result<TcpStream, ClientError> {
    let connected = timeout(CONNECT_LIMIT, TcpStream::connect(server.socket_address())).await;
    let connected = connected.map_err(|_| ClientError::TimedOut {
        what: "connection",
        limit: CONNECT_LIMIT,
    })?;
    let tcp = connected.map_err(|source| ClientError::Unreachable {
        authority: server.authority(),
        source,
    })?;
    // Without it small messages wait for company; where it cannot be set they do so and nothing else is lost.
    let _ = tcp.set_nodelay(true);
    Ok(tcp)
}

/// The worlds that run, oldest first.
///
/// Errors: those of [`get_json`].
pub async fn list_worlds(server: &ServerUrl) -> Result<Vec<WorldSummary>, ClientError> {
    let path = "/v1/worlds";
    let body = get_json(server, path).await?;
    serde_json::from_slice(&body).map_err(|e| ClientError::BadAnswer {
        path: path.to_owned(),
        why: e.to_string(),
    })
}

/// The body of the answer to a GET. `path` begins with `/` and is percent-encoded where it has to be.
///
/// Errors: [`ClientError::Unreachable`], [`ClientError::TimedOut`], [`ClientError::BadAnswer`] where the answer is not
/// HTTP or is too long, [`ClientError::Refused`] for a status other than 2xx.
pub async fn get_json(server: &ServerUrl, path: &str) -> Result<Vec<u8>, ClientError> {
    exchange(server, "GET", path, None).await
}

/// The body of the answer to a POST of a JSON text. Errors: those of [`get_json`].
pub async fn post_json(server: &ServerUrl, path: &str, body: &str) -> Result<Vec<u8>, ClientError> {
    exchange(server, "POST", path, Some(body)).await
}

async fn exchange(server: &ServerUrl, method: &str, path: &str, body: Option<&str>) -> Result<Vec<u8>, ClientError> {
    let mut tcp = open(server).await?;
    let exchange = async {
        let authority = server.authority();
        let mut request = format!(
            "{method} {path} HTTP/1.1\r\nHost: {authority}\r\nAccept: application/json\r\nConnection: close\r\n"
        );
        if let Some(body) = body {
            request += &format!("Content-Type: application/json\r\nContent-Length: {}\r\n", body.len());
        }
        request += "\r\n";
        request += body.unwrap_or_default();
        let unreachable = |source| ClientError::Unreachable {
            authority: authority.clone(),
            source,
        };
        tcp.write_all(request.as_bytes()).await.map_err(unreachable)?;
        let bad = |why| ClientError::BadAnswer {
            path: path.to_owned(),
            why,
        };
        let (status, body) = read_answer(&mut tcp).await.map_err(bad)?;
        if (200..300).contains(&status) {
            return Ok(body);
        }
        Err(ClientError::Refused(refusal(status, &body)))
    };
    let answered = timeout(ANSWER_LIMIT, exchange).await;
    answered.map_err(|_| ClientError::TimedOut {
        what: "answer",
        limit: ANSWER_LIMIT,
    })?
}

/// The world of that id, or the server's first. Errors: those of [`list_worlds`], [`ClientError::NoWorld`].
pub(crate) async fn world_or_first(server: &ServerUrl, world: Option<&str>) -> Result<String, ClientError> {
    if let Some(world) = world {
        return Ok(world.to_owned());
    }
    let first = list_worlds(server).await?.into_iter().next();
    first.map(|world| world.id).ok_or(ClientError::NoWorld)
}

/// The server's own error if the body holds one, else one made of the status.
pub(crate) fn refusal(status: u16, body: &[u8]) -> ApiError {
    serde_json::from_slice(body).unwrap_or_else(|_| ApiError::new("http_status", format!("HTTP status {status}")))
}

/// Bytes that were read ahead, and the connection that more come from.
struct Reader<'a, R> {
    source: &'a mut R,
    buffer: Vec<u8>,
}

impl<R: AsyncRead + Unpin> Reader<'_, R> {
    /// Reads some more; false at the end.
    async fn more(&mut self) -> Result<bool, String> {
        self.source
            .read_buf(&mut self.buffer)
            .await
            .map(|n| n > 0)
            .map_err(|e| e.to_string())
    }

    /// The bytes up to `end`, which is taken away too.
    async fn until(&mut self, end: &[u8], most: usize) -> Result<Vec<u8>, String> {
        loop {
            if let Some(at) = self.buffer.windows(end.len()).position(|w| w == end) {
                let mut found: Vec<u8> = self.buffer.drain(..at + end.len()).collect();
                found.truncate(at);
                return Ok(found);
            }
            if self.buffer.len() > most {
                return Err(format!("a head or line of more than {most} bytes"));
            }
            if !self.more().await? {
                return Err("it ends too early".to_owned());
            }
        }
    }

    async fn exactly(&mut self, count: usize) -> Result<Vec<u8>, String> {
        while self.buffer.len() < count {
            if !self.more().await? {
                return Err("it ends too early".to_owned());
            }
        }
        Ok(self.buffer.drain(..count).collect())
    }
}

/// Status and body of one answer.
async fn read_answer<R: AsyncRead + Unpin>(source: &mut R) -> Result<(u16, Vec<u8>), String> {
    let mut reader = Reader {
        source,
        buffer: Vec::new(),
    };
    let head = reader.until(b"\r\n\r\n", HEAD_BYTES_MAX).await?;
    let head = String::from_utf8(head).map_err(|_| "its head is not text".to_owned())?;
    let mut lines = head.split("\r\n");
    let status_line = lines.next().unwrap_or_default();
    let status = status_line
        .strip_prefix("HTTP/1.")
        .and_then(|rest| rest.split(' ').nth(1))
        .and_then(|code| code.parse::<u16>().ok())
        .ok_or_else(|| format!("it begins with {:?}", status_line.chars().take(40).collect::<String>()))?;
    let mut length = None;
    let mut chunked = false;
    for (name, value) in lines.filter_map(|line| line.split_once(':')) {
        let value = value.trim();
        if name.eq_ignore_ascii_case("content-length") {
            length = Some(value.parse::<usize>().map_err(|_| format!("its length is {value:?}"))?);
        } else if name.eq_ignore_ascii_case("transfer-encoding") {
            if !value.eq_ignore_ascii_case("chunked") {
                return Err(format!("its transfer encoding is {value:?}"));
            }
            chunked = true;
        }
    }
    let too_long = || format!("it has more than {BODY_BYTES_MAX} bytes");
    let body = if chunked {
        read_chunks(&mut reader).await?
    } else if let Some(length) = length {
        if length > BODY_BYTES_MAX {
            return Err(too_long());
        }
        reader.exactly(length).await?
    } else {
        while reader.more().await? {
            if reader.buffer.len() > BODY_BYTES_MAX {
                return Err(too_long());
            }
        }
        reader.buffer
    };
    Ok((status, body))
}

async fn read_chunks<R: AsyncRead + Unpin>(reader: &mut Reader<'_, R>) -> Result<Vec<u8>, String> {
    let mut body = Vec::new();
    loop {
        let line = reader.until(b"\r\n", 256).await?;
        let line = String::from_utf8_lossy(&line);
        let digits = line.split(';').next().unwrap_or_default().trim();
        let size = usize::from_str_radix(digits, 16).map_err(|_| format!("a chunk's size is {digits:?}"))?;
        if size > BODY_BYTES_MAX || body.len() + size > BODY_BYTES_MAX {
            return Err(format!("it has more than {BODY_BYTES_MAX} bytes"));
        }
        if size == 0 {
            return Ok(body); // trailers are of no interest, and the connection is not used again
        }
        body.extend(reader.exactly(size).await?);
        if reader.exactly(2).await? != b"\r\n" {
            return Err("a chunk is longer than it says".to_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    async fn read(text: &[u8]) -> Result<(u16, Vec<u8>), String> {
        let mut source = text;
        read_answer(&mut source).await
    }

    #[tokio::test]
    async fn all_three_kinds_of_body_are_read() {
        let length = read(b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\n[]ignored").await;
        assert_eq!(length, Ok((200, b"[]".to_vec())));
        let chunked =
            read(b"HTTP/1.1 404 Not Found\r\ntransfer-encoding: Chunked\r\n\r\n1\r\n[\r\n1;x=y\r\n]\r\n0\r\n\r\n")
                .await;
        assert_eq!(chunked, Ok((404, b"[]".to_vec())));
        let to_the_end = read(b"HTTP/1.0 200 OK\r\n\r\n[1]").await;
        assert_eq!(to_the_end, Ok((200, b"[1]".to_vec())));
    }

    #[tokio::test]
    async fn broken_answers_are_refused() {
        for text in [
            "",
            "SSH-2.0-OpenSSH\r\n\r\n",
            "HTTP/1.1 abc\r\n\r\n",
            "HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\n[]",
            "HTTP/1.1 200 OK\r\nContent-Length: -5\r\n\r\n[]",
            "HTTP/1.1 200 OK\r\nContent-Length: 99999999999\r\n\r\n[]",
            "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n[]\r\n0\r\n\r\n",
            "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\nffffffffffffffff\r\n[]\r\n0\r\n\r\n",
            "HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n1\r\n[]\r\n0\r\n\r\n",
            "HTTP/1.1 200 OK\r\nTransfer-Encoding: gzip\r\n\r\n[]",
        ] {
            assert!(read(text.as_bytes()).await.is_err(), "{text:?} was taken");
        }
        let endless = "HTTP/1.1 200 OK\r\nX: ".to_owned() + &"x".repeat(HEAD_BYTES_MAX + 1);
        assert!(read(endless.as_bytes()).await.is_err());
    }
}
