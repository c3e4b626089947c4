using Incise;
using UnityEngine;

namespace InciseUnity
{
    /// <summary>The connection to an incised, for the body and the blade that name it. It comes back by itself when it is lost.</summary>
    [AddComponentMenu("Incise/Connection")]
    [DefaultExecutionOrder(-100)] // before those who use it
    public sealed class InciseConnection : MonoBehaviour
    {
        public string host = "127.0.0.1";
        public int port = 7450;
        [Tooltip("Surface: what is drawn. Volume: the tetrahedra as well, for programs that compute with them.")]
        public View view = View.Surface;
        [Tooltip("Operator moves a blade. A Viewer only watches.")]
        public Role role = Role.Operator;
        [Tooltip("The name of an operator's blade: one that the server's configuration knows, or any other, up to 8 at once.")]
        public string sourceName = "unity";
        [Tooltip("Bring the blade's edge with this connection, instead of using the server's.")]
        public bool bringsBlade;
        [Tooltip("Ends of the edge in the tool's frame, metres, Unity's axes.")]
        public Vector3 heel = Vector3.zero;
        public Vector3 tip = new Vector3(0, -0.05f, 0);
        [Tooltip("Deltas a second at most; 0: one for each revision.")]
        public float maxRateHz;
        [Tooltip("TLS with the system's authorities.")]
        public bool tls;
        [Tooltip("Access token, if the server asks for one. Better set it from code than save it in a scene.")]
        public string token = "";

        /// <summary>Null while this component is disabled.</summary>
        public Client Client { get; private set; }

        private volatile string warning; // from the client's thread
        private ClientStatus shown;
        private string said = "";

        private void OnEnable()
        {
            var options = new ClientOptions
            {
                View = view, Role = role, SourceName = sourceName, MaxRateHz = maxRateHz, Tls = tls, Token = token,
                Blade = bringsBlade ? new BladeEdge(UnityFrame.Convert(heel.ToIncise()), UnityFrame.Convert(tip.ToIncise())) : null
            };
            Client = new Client(host, port, options);
            Client.ErrorReceived += error => warning = error.Code + ": " + error.Text;
            Client.Start();
            shown = ClientStatus.Connecting;
            said = "";
        }

        private void OnDisable()
        {
            if (Client == null) return;
            Client.Dispose();
            Client = null;
        }

        private void Update()
        {
            if (Client == null) return; // OnEnable has said why
            string told = warning;
            warning = null;
            if (told != null) Debug.LogWarning("Incise: " + told, this);
            ClientStatus status = Client.Status;
            string error = Client.LastError;
            if (status == shown && error == said) return;
            if (status == ClientStatus.Connected) Debug.Log("Incise: connected to " + host + ":" + port, this);
            else if (error.Length > 0) Debug.LogWarning("Incise: " + error + (status == ClientStatus.Closed ? "" : "; connecting again"), this);
            shown = status;
            said = error;
        }
    }
}
