using InciseUnity;
using UnityEngine;

/// <summary>Put this on an empty GameObject and press Play: a body, and a blade that sweeps to and fro through it.</summary>
public sealed class FirstCut : MonoBehaviour
{
    public string host = "127.0.0.1";
    public int port = 7450;
    [Tooltip("Bodies are a hand wide: 10 makes them easy to see.")]
    public float scale = 10;
    public float secondsPerSweep = 4;

    private InciseConnection connection;
    private InciseBody body;
    private InciseBlade blade;
    private float begun = -1;

    private void Start()
    {
        // Inactive until its fields are set: OnEnable connects.
        var root = new GameObject("Incise");
        root.SetActive(false);
        connection = root.AddComponent<InciseConnection>();
        connection.host = host;
        connection.port = port;
        connection.bringsBlade = true;
        connection.heel = new Vector3(0, 0.2f, 0);
        connection.tip = new Vector3(0, -0.2f, 0);

        GameObject cube = GameObject.CreatePrimitive(PrimitiveType.Cube);
        Material plain = cube.GetComponent<Renderer>().sharedMaterial; // the render pipeline's own
        var bodyObject = new GameObject("Body", typeof(MeshFilter), typeof(MeshRenderer));
        bodyObject.transform.SetParent(root.transform);
        bodyObject.transform.localScale = new Vector3(scale, scale, scale);
        bodyObject.GetComponent<MeshRenderer>().sharedMaterials = new[]
        {
            new Material(plain) { color = new Color(0.55f, 0.2f, 0.17f) }, new Material(plain) { color = new Color(0.8f, 0.35f, 0.3f) }
        };
        body = bodyObject.AddComponent<InciseBody>();
        body.connection = connection;

        cube.name = "Blade";
        cube.transform.SetParent(root.transform);
        cube.transform.localScale = new Vector3(0.002f, 0.4f, 0.004f) * scale;
        blade = cube.AddComponent<InciseBlade>();
        blade.connection = connection;
        blade.body = body;
        root.SetActive(true);
    }

    private void FixedUpdate()
    {
        if (!body.HasBody) return;
        if (begun < 0) begun = Time.time;
        // From one side of the body to the other, and back a little further along.
        Bounds bounds = body.GetComponent<MeshFilter>().sharedMesh.bounds;
        float sweeps = (Time.time - begun) / secondsPerSweep;
        float along = Mathf.PingPong(sweeps, 1) * 2.4f - 1.2f;
        float across = Mathf.Floor(sweeps) % 8 / 4 - 0.9f;
        var local = bounds.center + new Vector3(across * bounds.extents.x, 0, along * bounds.extents.z);
        blade.transform.position = body.transform.TransformPoint(local);
        blade.cut = true;
    }
}
