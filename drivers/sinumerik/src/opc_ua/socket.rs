//! The TCP connection below OPC UA. Closing always resets the connection, so that undelivered data never reach the
//! control later. Otherwise a request written before a cable was unplugged could move an axis when the cable is plugged
//! in again.

use std::{sync::Arc, time::Duration};

use opcua::{
    client::{
        ConnectionSource,
        transport::{
            Connector, RequestRecv, SecureChannelState, StreamConnection, StreamConnector,
            TcpTransport, TransportConfiguration,
        },
    },
    core::comms::tcp_codec::TcpCodec,
    types::{DecodingOptions, EndpointDescription, Error, StatusCode},
};
use rustix::net::sockopt::set_socket_linger;
use tokio::{
    io::{ReadHalf, WriteHalf},
    net::TcpStream,
};
use tokio_util::codec::FramedRead;

pub(super) struct ResetOnClose {
    pub(super) address: String,
    /// Maximum time for which sent data may stay unacknowledged. After it the connection ends.
    pub(super) time_out: Duration,
}

pub(super) struct ResetOnCloseConnector {
    address: String,
    time_out: Duration,
    endpoint_url: String,
}

impl ConnectionSource for ResetOnClose {
    type Builder = ResetOnCloseConnector;

    fn get_connector(
        &self,
        endpoint: &EndpointDescription,
    ) -> Result<ResetOnCloseConnector, Error> {
        Ok(ResetOnCloseConnector {
            address: self.address.clone(),
            time_out: self.time_out,
            endpoint_url: endpoint.endpoint_url.as_ref().to_owned(),
        })
    }
}

impl Connector for ResetOnCloseConnector {
    type Transport = TcpTransport;

    async fn connect(
        &self,
        channel: Arc<SecureChannelState>,
        outgoing: RequestRecv,
        config: TransportConfiguration,
    ) -> Result<TcpTransport, Error> {
        let (address, time_out) = (self.address.clone(), self.time_out);
        let open = move |url: String, decoding: DecodingOptions| {
            open(address.clone(), time_out, url, decoding)
        };
        StreamConnector::new(open, self.endpoint_url.clone())
            .connect(channel, outgoing, config)
            .await
    }

    fn default_endpoint(&self) -> EndpointDescription {
        EndpointDescription::from(self.endpoint_url.as_str())
    }
}

type Halves = StreamConnection<ReadHalf<TcpStream>, WriteHalf<TcpStream>>;

async fn open(
    address: String,
    time_out: Duration,
    url: String,
    decoding: DecodingOptions,
) -> Result<Halves, Error> {
    let failed = |error: std::io::Error| {
        Error::new(StatusCode::BadCommunicationError, format!("{address}: {error}"))
    };
    let stream = TcpStream::connect(&address).await.map_err(failed)?;
    stream.set_nodelay(true).map_err(failed)?;
    set_socket_linger(&stream, Some(Duration::ZERO)).map_err(|e| failed(e.into()))?;
    #[cfg(target_os = "linux")]
    {
        let ms = u32::try_from(time_out.as_millis()).unwrap_or(u32::MAX).max(1);
        // If the kernel does not support this option, only the deadlines of requests apply.
        let _ = rustix::net::sockopt::set_tcp_user_timeout(&stream, ms);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = time_out;
    let (reader, writer) = tokio::io::split(stream);
    let reader = FramedRead::new(reader, TcpCodec::new(decoding));
    Ok(StreamConnection::new(reader, writer, url))
}
